"""SHD features: how much they change when the input is turned, on the Fibonacci grid and on the equiangular one.

The descriptor should not notice a rotation; what it notices is the sampling. Both grids have as nearly the same
number of points as their constructions allow, each with the weights that are exact on it.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from benchmarks._table import Cell, Check, Column, Row, Table
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays

SAMPLES = Path(__file__).parents[1] / "samples"
_MODELS = ("gem.stl", "hand.ply", "starfish.ply", "horn.off", "trefoil_knot.ply", "double_torus.off", "bowl.off")


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of relative changes under random rotations of the samples."""
    models = [read_geometry_arrays(SAMPLES / name) for name in (_MODELS[:2] if quick else _MODELS)]
    meshes = [mesh for mesh in models if isinstance(mesh, MeshArrays)]
    turns = 1 if quick else 6
    exact = dataclasses.replace(fsh.SHDOption(), route="exact", distance="nearest")
    equiangular = {"grid": fsh.equiangular_grid(20), "weights": fsh.driscoll_healy_weights(20)}
    rows = []
    for name, option in (("energies, exact distances", exact), ("energies, soft distances", fsh.SHDOption())):
        mean = {}
        for grid, given in (
            ("Fibonacci 1536", option),
            ("equiangular 1600", dataclasses.replace(option, **equiangular)),
        ):
            change, seconds = _changes(meshes, given, turns)
            mean[grid] = float(change.mean())
            ratio = mean[grid] / mean["Fibonacci 1536"]
            cells: dict[str, Cell] = {
                "option": name,
                "grid": grid,
                "median": float(np.median(change)),
                "max": float(change.max()),
                "ratio": ratio,
                "seconds": seconds,
            }
            checks = (Check("mean change, equiangular / Fibonacci", ratio, ">=", 1.0),) if len(mean) == 2 else ()
            rows.append(Row(cells, checks))
    change, seconds = _changes(meshes, fsh.SHDOption.best(), turns)
    best: dict[str, Cell] = {"option": "best", "grid": "Fibonacci 864", "ratio": None, "seconds": seconds}
    best |= {"median": float(np.median(change)), "max": float(change.max())}
    limits = (Check("median", float(np.median(change)), "<=", 0.02), Check("max", float(change.max()), "<=", 0.08))
    rows.append(Row(best, limits))
    yield Table(
        "features_rotation",
        f"Relative change of SHD features under {turns} random rotations of {len(meshes)} sample meshes",
        (
            Column("option", "option"),
            Column("grid", "grid"),
            Column("median", "median %", ".3f", 100),
            Column("max", "max %", ".3f", 100),
            Column("ratio", "mean / Fibonacci's", ".2f"),
            Column("seconds", "ms a mesh", ".0f", 1e3),
        ),
        tuple(rows),
    )


def _changes(meshes: list[MeshArrays], option: fsh.SHDOption, turns: int) -> tuple[NDArray[np.float64], float]:
    """Relative L2 changes, one a mesh and rotation, and seconds a feature."""
    rotations = Rotation.random(turns, rng=np.random.default_rng(7)).as_matrix()
    fsh.shd_descriptor(meshes[0], option)  # plans are made once
    changes, begin = [], time.perf_counter()
    for mesh in meshes:
        here = fsh.shd_descriptor(mesh, option)
        for matrix in rotations:
            there = fsh.shd_descriptor(MeshArrays(mesh.vertices @ matrix.T, mesh.triangles), option)
            changes.append(np.linalg.norm(there - here) / np.linalg.norm(here))
    return np.array(changes), (time.perf_counter() - begin) / (len(meshes) * (turns + 1))
