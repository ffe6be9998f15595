"""The picture of an alignment: four panels, the shapes in their own colours whatever they bring along."""

from __future__ import annotations

import numpy as np
import pytest

from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import area_samples
from fsh3d_o3d.report.alignment import alignment_picture
from fsh3d_o3d.report.colors import ORIGINAL_COLOR

TETRAHEDRON = MeshArrays(
    np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
)
AWAY = MeshArrays(5 * TETRAHEDRON.vertices + 100, TETRAHEDRON.triangles)
SIZE = 120


def panels(picture: np.ndarray) -> list[np.ndarray]:
    """The four squares, without gaps and captions."""
    gap = (picture.shape[1] - 4 * SIZE) // 3
    return [picture[:SIZE, k * (SIZE + gap) : k * (SIZE + gap) + SIZE].astype(int) for k in range(4)]


def orange(panel: np.ndarray) -> float:
    """Share of the drawn pixels that are clearly the source's."""
    drawn = panel.min(axis=2) < 250
    return float(((panel[..., 0] - panel[..., 2] > 60) & drawn).sum() / drawn.sum())


def test_panels_show_who_is_who():
    target, source, aligned, both = panels(alignment_picture(AWAY, TETRAHEDRON, TETRAHEDRON, size=SIZE))
    assert orange(target) < 0.05
    assert orange(source) > 0.9
    assert orange(aligned) > 0.9
    assert 0.1 < orange(both) < 0.9  # they coincide, so neither hides the other
    assert np.array_equal(target.min(axis=2) < 250, aligned.min(axis=2) < 250)


def test_misaligned_shapes_do_not_mix():
    beside = MeshArrays(TETRAHEDRON.vertices * [1, 1, -1], TETRAHEDRON.triangles)
    target, _, aligned, _ = panels(alignment_picture(AWAY, TETRAHEDRON, beside, size=SIZE))
    assert not np.array_equal(target.min(axis=2) < 250, aligned.min(axis=2) < 250)


def test_clouds_lose_their_own_colours():
    points = area_samples(TETRAHEDRON, 3000)[0]
    cloud = PointArrays(points, None, np.tile([0.0, 1.0, 0.0], (3000, 1)))
    picture = alignment_picture(cloud, cloud, cloud, size=SIZE)
    target, source, *_ = panels(picture)
    assert orange(source) > 0.5
    drawn = target[target.min(axis=2) < 250]
    np.testing.assert_allclose(
        drawn.mean(axis=0) / drawn.mean(), np.array(ORIGINAL_COLOR) / np.mean(ORIGINAL_COLOR), atol=0.15
    )


def test_same_input_same_picture():
    first, second = (alignment_picture(AWAY, TETRAHEDRON, TETRAHEDRON, size=60) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_not_a_geometry():
    with pytest.raises(TypeError, match="geometry must be"):
        alignment_picture(1, TETRAHEDRON, TETRAHEDRON)
