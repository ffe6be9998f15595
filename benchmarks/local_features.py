"""Features of points: how often mutual nearest matches are right, and what a point costs, beside FPFH on the same ones.

Both describe the points of one cloud thinned to 3 % of the model's diagonal, as Open3D's tutorial does before FPFH;
ours looks at the whole cloud around them.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from benchmarks._alignment_pairs import asymmetric_shapes
from benchmarks._measure import limited
from benchmarks._open3d_peers import fpfh
from benchmarks._partial_pairs import Parts, Points, cut, unit_diagonal, views_apart
from benchmarks._table import Cell, Check, Column, Row, Table

_VOXEL = 0.03  # of the diagonal, as in registration's benchmark for the best of RANSAC
_RIGHT = 0.05  # of the diagonal; matched points closer than this in the true pose are right


@dataclass(frozen=True, eq=False)
class Pair:
    """Two clouds of one model of unit diagonal, in its pose."""

    source: Points
    target: Points
    turn: NDArray[np.float64]
    """(3, 3) by which the source is turned before it is described."""


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of shares of right matches and times."""
    shapes = [unit_diagonal(mesh) for _, mesh in asymmetric_shapes(2 if quick else 30, samples=quick)]
    rows = []
    for kind, parts in KINDS.items():
        random = np.random.default_rng(list(KINDS).index(kind))
        cases = [Pair(*parts(mesh, random), Rotation.random(rng=random).as_matrix()) for mesh in shapes]
        results = {name: _tried(method, cases) for name, method in METHODS.items()}
        peer_share, peer_seconds = (float(np.mean(part)) for part in zip(*results["FPFH"], strict=True))
        for name, tried in results.items():
            share, seconds = (float(np.mean(part)) for part in zip(*tried, strict=True))
            checks = (
                Check("times FPFH's share", share / max(peer_share, 1e-9), ">=", 2.0),
                Check("times FPFH's time", seconds / peer_seconds, "<=", 2.0),
            )
            cells: dict[str, Cell] = {
                "kind": kind,
                "method": name,
                "pairs": len(cases),
                "right": share,
                "ratio": share / max(peer_share, 1e-9),
                "seconds": seconds,
                "slower": seconds / peer_seconds,
            }
            rows.append(Row(cells, checks if name == "ours" else ()))
    yield Table(
        "local_features",
        f"Features of points of {len(shapes)} asymmetric shapes seen in part: mutual nearest matches",
        (
            Column("kind", "pair"),
            Column("method", "method"),
            Column("pairs", "pairs", "d"),
            Column("right", "right %", ".1f", 100),
            Column("ratio", "right / FPFH's", ".1f"),
            Column("seconds", "µs a point", ".0f", 1e6),
            Column("slower", "time / FPFH's", ".1f"),
        ),
        tuple(rows),
        notes=(
            f"right: closer than {100 * _RIGHT:g} % of the diagonal in the true pose.",
            "Processor time of one thread, with normals for FPFH and thinning for ours.",
        ),
    )


def _tried(method: Callable[[Points, Points, float], Any], cases: list[Pair]) -> list[tuple[float, float]]:
    """Shares of right matches and seconds a point, one a pair."""
    results = []
    with limited(1):
        for case in cases:
            source = case.source @ case.turn.T
            keys = [_thinned(cloud) for cloud in (source, case.target)]
            radius = fsh.LocalSHDOption.common(source, case.target).radius or 0.0
            begin = time.process_time()
            first, second = (method(cloud, key, radius) for cloud, key in zip((source, case.target), keys, strict=True))
            seconds = (time.process_time() - begin) / sum(map(len, keys))
            ours, theirs = _mutual(first.data.T, second.data.T)
            apart = np.linalg.norm(keys[0][ours] @ case.turn - keys[1][theirs], axis=1)
            results.append((float(np.mean(apart < _RIGHT)), seconds))
    return results


def _mutual(first: Points, second: Points) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows that are each other's nearest; Open3D's own filter gives all matches where few are mutual."""
    there, back = cKDTree(second).query(first)[1], cKDTree(first).query(second)[1]
    rows = np.flatnonzero(back[there] == np.arange(len(first)))
    return rows, there[rows]


def _ours(cloud: Points, keys: Points, radius: float) -> Any:
    return fsh.compute_local_shd_feature(cloud, fsh.LocalSHDOption(radius=radius), keys)


def _fpfh(_: Points, keys: Points, __: float) -> Any:
    thinned = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(keys))
    thinned.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * _VOXEL, 30))
    return fpfh(thinned, _VOXEL)


METHODS: dict[str, Callable[[Points, Points, float], Any]] = {"ours": _ours, "FPFH": _fpfh}
"""Of a cloud, its key points and a radius, an Open3D feature."""


def _thinned(cloud: Points) -> Points:
    thinned = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud)).voxel_down_sample(_VOXEL)
    return np.array(thinned.points)


KINDS: dict[str, Parts] = {
    "half cut off": functools.partial(cut, kept=0.5, noise=0.0),
    "views 60° apart": functools.partial(views_apart, degrees=60),
}
"""What of a model the two clouds of a pair show, by name."""
