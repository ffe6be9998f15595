"""Two clouds of one model, each of a part of it: depth views, parts cut off by planes, halves that share a third."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks._alignment_pairs import PSB, SAMPLES
from fsh3d_o3d.files import read_geometry_arrays
from fsh3d_o3d.geometry import MeshArrays, area_samples, ray_casting_scene

Points = NDArray[np.float64]

_EVERY, _FIRST = 45, 6  # of the models in the order of their names: about twenty, on which no setting was chosen
_SAMPLES = ("hand.ply", "starfish_posed.ply", "horn.off")
_LEAST_TRIANGLES = 300  # fewer are boxes and boards, whose parts look alike
_LEAST_POINTS = 200  # of a cloud; a view of a thin model from its edge shows less
_POINTS = 20_000  # of a whole, before a cut
_NOISE = 0.002  # of the diagonal: a good depth camera on an object that fills its picture
_MUCH_NOISE = 0.01  # of the diagonal: a cheap one
_RAYS = 220  # along a side of a depth view
_DISTANCE, _OPENING = 2.0, 32.0  # diagonals to the camera, and degrees that it sees
_TRUTH = 2000  # points of the model that tell how far a pose is off

Parts = Callable[[MeshArrays, np.random.Generator], tuple[Points, Points]]


@dataclass(frozen=True, eq=False)
class PartialPair:
    """Two clouds of a model of unit diagonal; the source is moved, the target is not."""

    source: Points
    target: Points
    rotation: NDArray[np.float64]
    """(3, 3) of the source's motion."""
    shift: NDArray[np.float64]
    """(3,) of the source's motion, after the rotation."""
    model: Points
    """Points all over the model, where the target is."""


def partial_shapes(count: int, *, samples: bool = False) -> list[tuple[str, MeshArrays]]:
    """Return up to so many models of unit diagonal about the origin, by name.

    They are spread over the Princeton benchmark's training half; where the data is missing, or if so wished, samples.
    """
    models = [] if samples else sorted(PSB.glob("*.off"))[_FIRST::_EVERY]
    shapes: list[tuple[str, MeshArrays]] = []
    for path in models or [SAMPLES / name for name in _SAMPLES]:
        mesh = read_geometry_arrays(path, isolated=False)
        if isinstance(mesh, MeshArrays) and len(mesh.triangles) >= _LEAST_TRIANGLES:
            shapes.append((path.stem, unit_diagonal(mesh)))
        if len(shapes) == count:
            break
    return shapes


def partial_pairs(shapes: list[tuple[str, MeshArrays]], kind: str) -> Iterator[PartialPair]:
    """Yield a pair a shape that shows enough of itself, in any rotation and moved by about its own size."""
    for number, (_, mesh) in enumerate(shapes):
        random = np.random.default_rng([number, list(PARTIAL_KINDS).index(kind)])
        source, target = PARTIAL_KINDS[kind](mesh, random)
        rotation, shift = Rotation.random(rng=random).as_matrix(), random.standard_normal(3)
        if min(len(source), len(target)) >= _LEAST_POINTS:
            truth = area_samples(mesh, _TRUTH)[0]
            yield PartialPair(source @ rotation.T + shift, target, rotation, shift, truth)


def unit_diagonal(mesh: MeshArrays) -> MeshArrays:
    """Move the middle of a mesh's box to the origin and make its diagonal 1."""
    low, high = mesh.used_vertices.min(axis=0), mesh.used_vertices.max(axis=0)
    return MeshArrays((mesh.vertices - (low + high) / 2) / mesh.diagonal, mesh.triangles)


def direction(random: np.random.Generator) -> Points:
    """Return any unit vector."""
    vector = random.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def depth_view(mesh: MeshArrays, toward: Points, random: np.random.Generator, noise: float = _NOISE) -> Points:
    """Return what a depth camera in that direction sees of a mesh of unit diagonal, with noise along its rays."""
    up = [0.0, 0.0, 1.0] if abs(toward[2]) < 0.9 else [0.0, 1.0, 0.0]
    scene = ray_casting_scene(mesh.vertices, mesh.triangles)
    rays = scene.create_rays_pinhole(_OPENING, [0.0, 0.0, 0.0], list(_DISTANCE * toward), up, _RAYS, _RAYS)
    depth = scene.cast_rays(rays)["t_hit"].numpy().ravel()
    lines = rays.numpy().reshape(-1, 6)[np.isfinite(depth)].astype(np.float64)
    length = np.linalg.norm(lines[:, 3:], axis=1)
    far = depth[np.isfinite(depth)] * length + noise * random.standard_normal(len(lines))
    return np.asarray(lines[:, :3] + lines[:, 3:] * (far / length)[:, None])


def views_apart(
    mesh: MeshArrays, random: np.random.Generator, *, degrees: float, noise: float = _NOISE
) -> tuple[Points, Points]:
    """Return two depth views whose cameras are so far apart, seen from the model's middle."""
    first, angle = direction(random), np.radians(degrees)
    beside = np.cross(first, direction(random))
    second = np.cos(angle) * first + np.sin(angle) * beside / np.linalg.norm(beside)
    return depth_view(mesh, first, random, noise), depth_view(mesh, second, random, noise)


def cut(mesh: MeshArrays, random: np.random.Generator, *, kept: float, noise: float = _NOISE) -> tuple[Points, Points]:
    """Return the share of a model that lies below a plane, and other points of the whole."""
    whole = _by_height(mesh, random, direction(random), noise)
    return whole[: round(kept * len(whole))], _whole(mesh, random, noise)


def _view_and_whole(mesh: MeshArrays, random: np.random.Generator) -> tuple[Points, Points]:
    return depth_view(mesh, direction(random), random), _whole(mesh, random)


def _sharing(mesh: MeshArrays, random: np.random.Generator, *, kept: float) -> tuple[Points, Points]:
    """The lower part of a model, and the upper part of other points of it."""
    along = direction(random)
    lower, upper = _by_height(mesh, random, along), _by_height(mesh, random, -along)
    count = round(kept * len(lower))
    return lower[:count], upper[:count]


def _by_height(mesh: MeshArrays, random: np.random.Generator, along: Points, noise: float = _NOISE) -> Points:
    points = _whole(mesh, random, noise)
    return points[np.argsort(points @ along, kind="stable")]


def _whole(mesh: MeshArrays, random: np.random.Generator, noise: float = _NOISE) -> Points:
    points = area_samples(mesh, _POINTS, seed=int(random.integers(2**31)))[0]
    return np.asarray(points + noise * random.standard_normal(points.shape))


PARTIAL_KINDS: dict[str, Parts] = {
    "view and whole": _view_and_whole,
    "views 30° apart": functools.partial(views_apart, degrees=30),
    "views 60° apart": functools.partial(views_apart, degrees=60),
    "views 90° apart": functools.partial(views_apart, degrees=90),
    "30 % cut off": functools.partial(cut, kept=0.7),
    "half cut off": functools.partial(cut, kept=0.5),
    "80 % cut off": functools.partial(cut, kept=0.2),
    "parts that share a third": functools.partial(_sharing, kept=0.6),  # 20 % of the whole is a third of 60 %
    "views 30° apart, 1 % noise": functools.partial(views_apart, degrees=30, noise=_MUCH_NOISE),
}
"""What of a model the two clouds of a pair show, by name."""
