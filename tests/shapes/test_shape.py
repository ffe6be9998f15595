"""All shapes follow one protocol: the same words, in the same order, with the same defaults."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import numpy as np
import open3d as o3d
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.geometry.arrays import MeshArrays
from tests.geometry.mesh_shapes import sphere

KINDS = (fsh.RadialShape, fsh.ShellShape, fsh.ConformalShape)


def methods() -> Iterator[str]:
    return (name for name, value in vars(fsh.Shape).items() if not name.startswith("_") and not is_property(value))


def is_property(value: object) -> bool:
    return isinstance(value, property)


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: kind.__name__)
def shape(request: pytest.FixtureRequest) -> fsh.Shape:
    return request.param.from_geometry(sphere(8), 6, threads=1)


def test_is_a_shape(shape: fsh.Shape) -> None:
    assert isinstance(shape, fsh.Shape)
    assert not isinstance(MeshArrays(np.eye(3), np.arange(3)[None]), fsh.Shape)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", list(methods()))
def test_methods_have_the_parameters_of_the_protocol(kind: type, name: str) -> None:
    expected, found = (inspect.signature(getattr(owner, name)).parameters for owner in (fsh.Shape, kind))
    pairs = []
    for position, (word, parameter) in enumerate(expected.items()):
        if parameter.kind is parameter.POSITIONAL_ONLY:  # what it is counts, each shape has a name for it
            own = list(found.values())[position]
            assert own.kind is own.POSITIONAL_OR_KEYWORD
        else:
            own = found[word]
            assert own.kind is parameter.kind and own.annotation == parameter.annotation
        assert parameter.default in (own.default, ...)
        pairs.append(own)
    for own in found.values():
        assert own in pairs or own.default is not own.empty  # what a shape has besides may be left out
        assert own in pairs or own.name not in ("tensor", "legacy", "n_points", "number_of_points")


def test_the_kind_of_open3d_objects_is_asked_for_by_one_word(shape: fsh.Shape) -> None:
    assert shape.kind == "legacy"
    assert isinstance(shape.to_triangle_mesh(40, kind="tensor"), o3d.t.geometry.TriangleMesh)
    assert isinstance(shape.to_point_cloud(50, kind="tensor"), o3d.t.geometry.PointCloud)
    for decode in (shape.to_triangle_mesh, shape.to_point_cloud):
        with pytest.raises(ValueError, match="kind must be one of 'legacy', 'tensor'"):
            decode(50, kind="plastic")
    assert "kind" in inspect.signature(fsh.read_geometry).parameters


def test_what_is_made_of_a_shape_is_of_its_kind(shape: fsh.Shape, random_rotation: np.ndarray) -> None:
    made = shape.truncated(4), shape.filtered(np.ones(6)), shape.rotated(random_rotation)
    assert [type(other) for other in made] == [type(shape)] * 3
    assert [other.bandwidth for other in made] == [4, 6, 6]
    for other in made:
        assert other.kind == shape.kind and not other.coefficients.flags.writeable
    np.testing.assert_allclose(made[1].coefficients, shape.coefficients, rtol=1e-12, atol=1e-15)


def test_functions_are_evaluated_by_one_word(shape: fsh.Shape) -> None:
    values = shape.evaluate(np.eye(3), threads=1)
    assert values.dtype == np.float64 and len(values) == 3
    assert len(shape.to_point_cloud().points) == 10_000
