"""Small libraries and indices for tests. At the top of a module, so that processes find the functions."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fsh3d_o3d.descriptors.shd import SHDOption
from fsh3d_o3d.files.writing import write_geometry
from fsh3d_o3d.geometry.arrays import MeshArrays
from fsh3d_o3d.index.shape_index import ShapeIndex
from fsh3d_o3d.sphere.icosahedron import icosphere

QUICK = SHDOption(
    bandwidth=4, shells=8, voxels=24, samples=1024, smoothing=0.2, invariant="cross_shell", normalisation="l1"
)
"""An option that takes milliseconds."""
NOT_AT_ALL = 0
"""Seconds for which a version is kept that is old as soon as it is replaced, however soon that is asked."""


def blob(number: int) -> MeshArrays:
    """A closed mesh; each number gives another shape, without symmetry."""
    random = np.random.default_rng(number)
    directions, triangles = icosphere(6)
    bumps = random.standard_normal((5, 3))
    radius = 1 + sum(
        0.5 * np.exp(-3 * np.square(directions - bump / np.linalg.norm(bump)).sum(axis=1)) for bump in bumps
    )
    return MeshArrays(directions * radius[:, None] * (1 + random.random(3)), triangles)


def write_library(folder: Path, numbers) -> list[str]:
    """Files of ``blob``."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in numbers:
        path = folder / f"blob{number}.off"
        write_geometry(path, blob(number))
        paths.append(os.fspath(path))
    return paths


def fill(index: str, paths: list[str]) -> None:
    """What a writing process does."""
    ShapeIndex.open(index, create=True, option=QUICK).add_files(paths, workers=1)


def fill_slowly(index: str, paths: list[str], pictures: int | None = None) -> None:
    """The same, with a commit after every file and time to be killed in; it stays there after some pictures."""
    from fsh3d_o3d.index import filling as filling

    filling._ROWS_A_COMMIT = 1
    thumbnail = SlowThumbnail(pictures)
    ShapeIndex.open(index, create=True, option=QUICK).add_files(paths, workers=1, thumbnail=thumbnail)


@dataclass
class SlowThumbnail:
    """Takes its time, and stays at work after some pictures."""

    pictures: int | None

    def __call__(self, _) -> bytes:
        writer = os.getppid()
        while self.pictures == 0 and os.getppid() == writer:  # not longer than the writer lives
            time.sleep(0.05)
        self.pictures = None if self.pictures is None else self.pictures - 1
        time.sleep(0.05)
        return b"picture"
