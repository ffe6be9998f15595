"""Shapes without symmetry, and copies of them that are moved, meshed anew, decimated, noisy, or clouds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
import pymeshlab
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import fsh3d_o3d as fsh
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, PointArrays, area_samples, weld
from fsh3d_o3d.registration import plain_surface, resolved_surface, shell_coefficients

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "samples"
PSB = ROOT.parent / "data" / "psb_train" / "models"
_ASYMMETRIC = ("horn.off", "hand.ply", "starfish_posed.ply", "stone_degree8.ply", "bennu_like_low.ply")
_OTHER_MAXIMUM = 0.8  # of the self-correlation; shapes that come closer to looking alike in two poses are left out
_LEAST_TRIANGLES = 200  # a fifth of fewer is another shape
_LEAST_CURVATURE = 1.0  # of the self-correlation, per radian²; below it lies an axis of revolution
_CLOUD = 8000


@dataclass(frozen=True, eq=False)
class Pair:
    """A shape and a moved, changed copy of it."""

    name: str
    """Of the shape."""
    source: MeshArrays
    """The shape."""
    target: MeshArrays | PointArrays
    """Its copy: scale · rotation · x + shift, changed as the kind says."""
    rotation: NDArray[np.float64]
    """(3, 3), the truth."""
    scale: float
    """The truth."""
    kept: float
    """Share of the shape's area within 5 % of the diagonal of the changed copy: decimation may lose parts."""


def asymmetric_shapes(count: int, *, samples: bool = False) -> list[tuple[str, MeshArrays]]:
    """Return the first shapes of the Princeton benchmark's training half that are unlike themselves in other poses.

    Where the data is missing, or if so wished, samples.
    """
    chosen: list[tuple[str, MeshArrays]] = []
    models = [] if samples else sorted(PSB.glob("*.off"), key=lambda path: int(path.stem[1:]))
    for path in models or [SAMPLES / name for name in _ASYMMETRIC]:
        mesh = read_geometry_arrays(path, isolated=False)
        if not isinstance(mesh, MeshArrays) or len(mesh.triangles) < _LEAST_TRIANGLES:
            continue
        coefficients = shell_coefficients(resolved_surface(plain_surface(mesh, 4096)), 16)
        itself = fsh.estimate_rotation(coefficients, coefficients, maxima=3)
        if itself.correlations[1:].max(initial=0) < _OTHER_MAXIMUM and itself.curvature[0] > _LEAST_CURVATURE:
            chosen.append((path.stem, mesh))
        if len(chosen) == count:
            break
    return chosen


def pairs(shapes: list[tuple[str, MeshArrays]], kind: str) -> Iterator[Pair]:
    """Yield a pair a shape: any rotation, 1/e … e times as large, moved by about its own size."""
    for number, (name, mesh) in enumerate(shapes):
        random = np.random.default_rng([number, list(KINDS).index(kind)])
        changed = KINDS[kind](mesh, random)
        rotation = Rotation.random(rng=random).as_matrix()
        scale, shift = float(np.exp(random.uniform(-1, 1))), mesh.diagonal * random.normal(size=3)
        field = "vertices" if isinstance(changed, MeshArrays) else "points"
        moved = scale * getattr(changed, field) @ rotation.T + shift
        yield Pair(name, mesh, dataclasses.replace(changed, **{field: moved}), rotation, scale, _kept(mesh, changed))


def _kept(mesh: MeshArrays, changed: MeshArrays | PointArrays) -> float:
    points = area_samples(changed, _CLOUD)[0] if isinstance(changed, MeshArrays) else changed.points
    distance = np.asarray(cKDTree(points).query(area_samples(mesh, 2000)[0])[0])
    return float(np.mean(distance <= 0.05 * mesh.diagonal))


def _same(mesh: MeshArrays, random: np.random.Generator) -> MeshArrays:
    """The same triangles in another order, so that samples of them are others."""
    return MeshArrays(mesh.vertices, random.permutation(mesh.triangles))


def _remeshed(mesh: MeshArrays, _: np.random.Generator) -> MeshArrays:
    """Isotropic triangles of 2 % of the diagonal (MeshLab)."""
    welded = weld(mesh)
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(welded.vertices, welded.triangles.astype(np.int32)))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=4, targetlen=pymeshlab.PercentageValue(2.0), checksurfdist=False
    )
    result = meshes.current_mesh()
    return MeshArrays(result.vertex_matrix(), result.face_matrix())


def _decimated(mesh: MeshArrays, _: np.random.Generator) -> MeshArrays:
    """A fifth of the triangles (Open3D's quadric decimation)."""
    welded = weld(mesh)
    legacy = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(welded.vertices)),
        o3d.utility.Vector3iVector(welded.triangles.astype(np.int32)),
    )
    simple = legacy.simplify_quadric_decimation(len(mesh.triangles) // 5)
    return MeshArrays(np.asarray(simple.vertices), np.asarray(simple.triangles))


def _noisy(mesh: MeshArrays, random: np.random.Generator) -> MeshArrays:
    """Every vertex moved by a Gaussian of 1 % of the diagonal along each axis."""
    welded = weld(mesh)
    noise = 0.01 * mesh.diagonal * random.normal(size=welded.vertices.shape)
    return MeshArrays(welded.vertices + noise, welded.triangles)


def _cloud(mesh: MeshArrays, random: np.random.Generator) -> PointArrays:
    """Points of the surface, spread by area, without normals."""
    return PointArrays(area_samples(mesh, _CLOUD, seed=int(random.integers(2**31)))[0])


KINDS: dict[str, Callable[[MeshArrays, np.random.Generator], MeshArrays | PointArrays]] = {
    "same mesh": _same,
    "remeshed": _remeshed,
    "20 % of the triangles": _decimated,
    "1 % noise": _noisy,
    "point cloud": _cloud,
}
"""How a copy differs from the shape, by name."""
