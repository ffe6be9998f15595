"""``fsh3d cache``: where solved weights and descriptors are kept, and how to be rid of them."""

from __future__ import annotations

import argparse
from typing import Any

from fsh3d_o3d.cli.console import say
from fsh3d_o3d.jobs import clear_descriptor_cache, descriptor_cache_path
from fsh3d_o3d.sphere import clear_weight_cache, weight_cache_directory


def add_parser(commands: Any) -> None:
    """Add the sub-command."""
    parser = commands.add_parser("cache", help="show or clear the cache of solved weights and descriptors")
    parser.add_argument("--clear", action="store_true", help="remove everything in it")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the folder and its size, or clear it."""
    folder = weight_cache_directory()
    if options.clear:
        clear_descriptor_cache()
        say(f"removed {clear_weight_cache()} files from {folder}, and all descriptors from {descriptor_cache_path()}")
        return 0
    sizes = [path.stat().st_size for path in folder.glob("*.npz")]
    say(f"{folder}: {len(sizes)} files, {sum(sizes) / 2**20:.1f} MiB")
    descriptors = descriptor_cache_path()
    size = descriptors.stat().st_size if descriptors.exists() else 0
    say(f"{descriptors}: {size / 2**20:.1f} MiB")
    return 0
