"""``fsh3d view``: a file as a page in which it can be turned."""

from __future__ import annotations

import argparse
import os
import webbrowser
from pathlib import Path
from typing import Any

from fsh3d_o3d.cli.console import Progress, say
from fsh3d_o3d.cli.targets import checked_targets
from fsh3d_o3d.files import read_geometry_arrays


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser(
        "view",
        help="write a page that shows a file in 3D, offline",
        description="Write a page that shows a mesh, a point cloud or a saved shape (.npz) in 3D, in its own colours. "
        "The page works offline in any browser, and needs neither a display nor a graphics card to be written.",
    )
    parser.add_argument("file", help="mesh, point cloud, or shape (.npz)")
    parser.add_argument(
        "-o", "--output", metavar="PAGE.html", help="page to write (default: the file's name with .html, here)"
    )
    parser.add_argument("--open", action="store_true", help="also open it in the browser")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Carry out the command."""
    output = options.output or f"{Path(options.file).name}.html"
    checked_targets({"the page": (output, (".html", ".htm"))}, {"the file": options.file})
    with Progress(2, not options.quiet) as progress:
        progress.step("reading")
        geometry = read_geometry_arrays(options.file)
        progress.step("drawing")
        # Imported here: drawing takes time to load that other commands need not spend.
        from fsh3d_o3d.report import write_view_page

        write_view_page(output, geometry, title=os.path.basename(options.file))  # noqa: PTH119 - any bytes
    say(f"wrote {output}")
    if options.open:
        webbrowser.open(Path(output).resolve().as_uri())
    return 0
