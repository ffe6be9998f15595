"""Scripts run as a user runs them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def run_script(
    path: Path, *arguments: object, folder: Path | None = None, timeout: float = 300
) -> subprocess.CompletedProcess[str]:
    """Run a Python script in a folder (default: this process's) and return how it ended and what it printed."""
    return subprocess.run(
        [sys.executable, str(path), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        cwd=folder,
    )
