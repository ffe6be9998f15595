"""Build the wheel and the source distribution, install the wheel where nothing else is, and run the command there.

Run by ``.ci/run``, for every Python that the package supports and this machine has; those that are missing are named.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from constraints import PYTHONS, ROOT, find_python

SAMPLE = ROOT / "samples" / "horn.off"


def run(command: Sequence[str | Path], folder: Path) -> str:
    """Return what a command prints; its failure, with all that it said, ends this script."""
    done = subprocess.run([*map(os.fspath, command)], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"wheel: {' '.join(map(str, command))} ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def try_wheel(python: str, wheel: Path, folder: Path) -> None:
    """Install the wheel into an environment of its own and use it from a folder that is not the clone."""
    environment, outside = folder / "environment", folder / "outside"
    outside.mkdir(parents=True)
    run([python, "-m", "venv", environment], outside)
    pip = [environment / "bin" / "python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    run([*pip, "--constraint", ROOT / "constraints.txt", f"{wheel}[cpu]"], outside)
    command = environment / "bin" / "fsh3d"
    if "closed" not in run([command, "info", SAMPLE], outside):
        sys.exit("wheel: fsh3d info says nothing of the sample")
    run([command, "reconstruct", SAMPLE, "again.ply", "--method", "conformal", "--report", "page.html"], outside)
    for name in ("again.ply", "page.html"):
        if not (outside / name).stat().st_size:
            sys.exit(f"wheel: {name} is empty")


def main() -> None:
    """Build, then try on each Python."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # The wheel is built from the source distribution: a file that is missing there is missing in both.
        run([sys.executable, "-m", "build", "--outdir", folder / "built", ROOT], folder)
        (wheel,) = (folder / "built").glob("*.whl")
        (source,) = (folder / "built").glob("*.tar.gz")
        print(f"built {source.name} and {wheel.name}", flush=True)
        tried = 0
        for version in PYTHONS:
            try:
                python = find_python(version)
            except FileNotFoundError:
                print(f"Python {version}: not on this machine")
                continue
            start = time.monotonic()
            try_wheel(python, wheel, folder / version)
            tried += 1
            print(f"Python {version}: installed and used in {time.monotonic() - start:.0f} s", flush=True)
        if not tried:
            sys.exit("wheel: no supported Python found to try it on")


if __name__ == "__main__":
    main()
