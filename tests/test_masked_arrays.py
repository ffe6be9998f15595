"""Masked arrays: what is under a mask is no value, and is refused at every door; a mask that hides nothing is none."""

from __future__ import annotations

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.sphere.icosahedron import icosphere

VERTICES, TRIANGLES = icosphere(2)
GRID = fsh.fibonacci_grid(6 * 4**2)
TRANSFORM = fsh.SphericalHarmonicTransform(4)
COEFFICIENTS = np.arange(1.0, 17.0)
POINTS = np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1]])
DISTANCES = np.abs(np.subtract.outer(np.arange(6.0), np.arange(6.0)))
LABELS = np.array([0, 0, 0, 1, 1, 1])
ROTATION = np.eye(3)
PACKED = fsh.to_packed(COEFFICIENTS)
DOORS = {
    "vertices": (VERTICES, lambda a: MeshArrays(a, TRIANGLES)),
    "triangles": (TRIANGLES, lambda a: MeshArrays(VERTICES, a)),
    "points": (POINTS, PointArrays),
    "normals": (POINTS, lambda a: PointArrays(POINTS, a)),
    "colors": (np.abs(POINTS), lambda a: PointArrays(POINTS, colors=a)),
    "grid": (POINTS, fsh.grid_from_directions),
    "weights": (np.ones(len(GRID)), lambda a: fsh.SphericalHarmonicTransform(4, GRID, a)),
    "forward": (np.ones(96), TRANSFORM.forward),
    "inverse": (COEFFICIENTS, TRANSFORM.inverse),
    "evaluate coefficients": (COEFFICIENTS, lambda a: fsh.evaluate(a, POINTS)),
    "evaluate directions": (POINTS, lambda a: fsh.evaluate(COEFFICIENTS, a)),
    "energies": (COEFFICIENTS, fsh.degree_energies),
    "rotate": (COEFFICIENTS, lambda a: fsh.rotate_coefficients(a, ROTATION)),
    "rotation": (ROTATION, lambda a: fsh.rotate_coefficients(COEFFICIENTS, a)),
    "estimate": (COEFFICIENTS, lambda a: fsh.estimate_rotation(a, COEFFICIENTS).correlation),
    "symmetries": (COEFFICIENTS, lambda a: fsh.find_symmetries(a) and None),
    "canonical": (COEFFICIENTS, lambda a: fsh.canonical_rotation(a).rotation),
    "to_complex": (COEFFICIENTS, fsh.to_complex),
    "from_complex": (fsh.to_complex(COEFFICIENTS), fsh.from_complex),
    "from_packed": (PACKED, fsh.from_packed),
    "shape": (COEFFICIENTS, lambda a: fsh.RadialShape(a, np.zeros(3)).coefficients),
    "center": (np.zeros(3), lambda a: fsh.RadialShape(COEFFICIENTS, a).center),
    "distances": (DISTANCES, lambda a: fsh.retrieval_metrics(a, LABELS).nearest_neighbor),
    "labels": (LABELS, lambda a: fsh.retrieval_metrics(DISTANCES, a).nearest_neighbor),
    "rows": (list(POINTS), PointArrays),
}


def outcome(door, array):
    found = door(array)
    parts = vars(found).values() if hasattr(found, "__dict__") else [found]
    return [part for part in parts if isinstance(part, np.ndarray | float)]


@pytest.mark.parametrize("name", DOORS)
def test_masked_values_are_refused(name):
    array, door = DOORS[name]
    hidden = np.ma.array(array, mask=False)
    hidden[(1,) * hidden.ndim] = np.ma.masked
    with pytest.raises(ValueError, match=r"must not be masked, but 1 of \d+ values are: .* \.filled"):
        door(list(hidden) if isinstance(array, list) else hidden)


@pytest.mark.parametrize("name", DOORS)
def test_a_mask_that_hides_nothing_is_none(name):
    array, door = DOORS[name]
    bare = np.ma.array(array)
    for given in (bare, np.ma.array(bare, mask=np.zeros(bare.shape, dtype=bool))):
        np.testing.assert_equal(outcome(door, list(given) if isinstance(array, list) else given), outcome(door, array))


def test_masked_numbers_are_refused():
    with pytest.raises(ValueError, match="bandwidth must not be masked"):
        fsh.SphericalHarmonicTransform(np.ma.array(4, mask=True))
    with pytest.raises(ValueError, match="masked"):
        fsh.RadialShape(COEFFICIENTS, [0.0, np.ma.masked, 0.0])
