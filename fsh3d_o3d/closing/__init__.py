"""A closed surface of genus 0 for any mesh."""

from __future__ import annotations

from fsh3d_o3d.closing.prepare_closed import Closing, Parts, prepare_closed

__all__ = [
    "Closing",
    "Parts",
    "prepare_closed",
]
