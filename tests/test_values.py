"""What grids, options, shapes and results have in common: they travel, compare, print on a line, stay as they are."""

from __future__ import annotations

import copy
import dataclasses
import functools
import importlib
import inspect
import multiprocessing
import pickle
import pkgutil
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors.cpshd import CPSHDOption
from fsh3d_o3d.descriptors.library import CPSHDDescriptor, SHDDescriptor
from fsh3d_o3d.descriptors.shd import compute_signature
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from fsh3d_o3d.geometry.measures import measure_mesh
from fsh3d_o3d.radial.star import star_center
from fsh3d_o3d.shapes.shape import HarmonicShape
from tests.geometry.mesh_shapes import box
from tests.optional import HAS_TORCH

LONGEST = 360  # characters of a line that is printed of a value with a dozen fields
NO_VALUES = {"Shape", "ShapeIndex", "SphericalRegistrationTarget"}  # a protocol, an open folder, what fills with use


@value
class Pair:
    """A value of this test, with what others have among their fields."""

    name: str
    numbers: np.ndarray
    more: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    parts: tuple[Any, ...] = ()


def read_only(*shape: int) -> np.ndarray:
    array = np.arange(np.prod(shape), dtype=np.float64).reshape(shape) + 0.5
    array.setflags(write=False)
    return array


@functools.cache
def examples() -> dict[type, Any]:
    """A value of every class that is one: as the package makes it, or made up where nothing is checked."""
    mesh, functions = box((0.5, 1.0, 2.0)), read_only(2, 36)
    grid = fsh.equiangular_grid(4)
    weights = fsh.driscoll_healy_weights(4)
    report = fsh.find_symmetries(functions)
    metrics = fsh.retrieval_metrics(np.arange(36.0).reshape(6, 6), [0, 0, 0, 1, 1, 1])
    aligned = fsh.registration_spherical(mesh, mesh)
    colors = {"height": mesh.vertices[:, 2], "colors": np.full((len(mesh.vertices), 3), 0.5)}
    shells = fsh.ShellShape.from_geometry(mesh, 4, 6, "signed_distance", width=np.inf)
    known = [
        Pair("pair", read_only(2), MappingProxyType({"x": read_only(3)}), (read_only(2), Pair("inner", read_only(1)))),
        grid,
        fsh.SphericalHarmonicTransform(4, grid, weights),
        fsh.analytic_weights(grid, 2),
        fsh.fit_coefficients(np.ones(len(grid)), grid, 2),
        fsh.estimate_rotation(functions, functions),
        fsh.canonical_rotation(functions),
        report,
        mesh,
        PointArrays(read_only(4, 3), read_only(4, 3)),
        measure_mesh(mesh),
        fsh.surface_error(mesh, mesh, samples=100),
        fsh.RadialShape.from_geometry(mesh, 4),
        shells,
        fsh.ConformalShape.from_geometry(mesh, 4, attributes=colors),
        shells.to_volume(8),
        HarmonicShape(read_only(16)),
        star_center(mesh),
        fsh.conformal_map(mesh),
        fsh.ConformalMapOption(area_weight=1),
        fsh.prepare_closed(mesh),
        fsh.SHDOption(bandwidth=4, grid=grid, weights=weights),
        CPSHDOption(bandwidth=4, grid=grid, weights=weights),
        SHDDescriptor(fsh.SHDOption()),
        CPSHDDescriptor(CPSHDOption()),
        fsh.SHDOption().shell_fields,
        compute_signature(mesh),
        fsh.SphericalRegistrationOption(candidates=3),
        aligned,
        fsh.register_scans([mesh]),
        metrics,
        metrics.macro,
        metrics.classes[0],
    ]
    found = {type(example): example for example in known}
    return {**found, **{cls: made_up(cls) for cls in values() if cls not in found}}


def made_up(cls: type) -> Any:
    """A value whose fields are of about the types that they should be."""
    kinds = {
        "float": 0.25,
        "int": 3,
        "str": "some text",
        "bool": True,
        "bytes": bytes(5000),
        "tuple": (),
        "dict": {"a": 1},
    }
    fields = {field.name: field.type.split(" | ")[0].split("[")[0] for field in dataclasses.fields(cls)}
    return cls(**{name: kinds.get(kind, read_only(5, 3)) for name, kind in fields.items()})


@functools.cache
def values() -> tuple[type, ...]:
    """All classes of the package that are values."""
    shared = vars(Pair)["__reduce__"]
    found = []
    for module in pkgutil.walk_packages(fsh.__path__, "fsh3d_o3d."):
        left_out = not HAS_TORCH and module.name.startswith("fsh3d_o3d.torch")
        if not module.name.endswith("__main__") and not left_out:
            for _, cls in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
                if vars(cls).get("__reduce__") is shared and cls not in found:
                    found.append(cls)
    return tuple(found)


def arrays_in(part: Any) -> Iterator[np.ndarray]:
    if isinstance(part, np.ndarray):
        yield part
    elif isinstance(part, Mapping):
        for inner in part.values():
            yield from arrays_in(inner)
    elif isinstance(part, tuple):
        for inner in part:
            yield from arrays_in(inner)
    elif dataclasses.is_dataclass(part):
        for field in dataclasses.fields(part):
            yield from arrays_in(getattr(part, field.name))


def writeable(part: Any) -> list[bool]:
    return [array.flags.writeable for array in arrays_in(part)]


def arrived(sent: list[Any]) -> list[tuple[Any, str, list[bool]]]:
    """Runs in a process that was spawned: what came there."""
    return [(one, repr(one), writeable(one)) for one in sent]


def test_every_public_class_of_results_and_options_is_a_value() -> None:
    public = [getattr(fsh, name) for name in fsh.__all__ if name not in NO_VALUES]
    classes = [cls for cls in public if inspect.isclass(cls) and not issubclass(cls, Exception)]
    assert len(classes) > 20
    assert [cls.__name__ for cls in classes if cls not in values()] == []


def test_values_travel_to_processes_that_are_spawned_and_back() -> None:
    sent = list(examples().values())
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        back = pool.submit(arrived, sent).result()
    for one, (again, text, flags) in zip(sent, back, strict=True):
        assert type(again) is type(one) and again == one and hash(again) == hash(one)
        assert text == repr(one)
        assert flags == writeable(one) == writeable(again), type(one).__name__


@pytest.mark.parametrize("cls", [Pair, *values()], ids=lambda cls: cls.__name__)
def test_value(cls: type) -> None:
    one = examples()[cls]
    for again in (copy.copy(one), copy.deepcopy(one), *(pickle.loads(pickle.dumps(one, n)) for n in (2, 5))):
        assert vars(again).keys() <= {field.name for field in dataclasses.fields(cls)}  # nothing that is kept beside
        assert again == one and hash(again) == hash(one)
        assert writeable(again) == writeable(one)
    name = dataclasses.fields(cls)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(again, name, None)
    with pytest.raises(dataclasses.FrozenInstanceError):
        delattr(again, name)
    text = repr(one)
    assert text.startswith(f"{cls.__name__}(") and text.isprintable() and len(text) < LONGEST
    assert "array(" not in text and "0x" not in text
    assert one != object() and one not in (None, 3)


def test_values_differ_where_a_field_does() -> None:
    pair = Pair("pair", read_only(2), {"x": read_only(2)}, (read_only(2),))
    for changes in (
        {"name": "other"},
        {"numbers": read_only(3)},
        {"numbers": read_only(2) + 1},
        {"numbers": None},
        {"more": {"y": read_only(2)}},
        {"more": {"x": read_only(2) + 1}},
        {"parts": (read_only(2) + 1,)},
        {"parts": ()},
    ):
        assert dataclasses.replace(pair, **changes) != pair
    assert dataclasses.replace(pair, numbers=np.array([np.nan])) == dataclasses.replace(
        pair, numbers=np.array([np.nan])
    )


def test_attributes_of_a_shape_stay_read_only_on_the_way() -> None:
    again = pickle.loads(pickle.dumps(examples()[fsh.ConformalShape]))
    with pytest.raises(TypeError):
        again.attributes["height"] = 1
    with pytest.raises(ValueError, match="read-only"):
        again.attributes["height"][0] = 1


def test_a_transform_works_where_it_arrives() -> None:
    transform = fsh.SphericalHarmonicTransform(6, analysis="least_squares", threads=1)
    again = pickle.loads(pickle.dumps(transform))
    values = transform.grid.directions[:, 2] ** 2
    assert np.array_equal(again.forward(values), transform.forward(values))
    assert len(pickle.dumps(transform)) < 60 * len(transform.grid)  # its grid and weights, and no matrices


def test_what_is_printed_tells_sizes_and_what_is_not_usual() -> None:
    assert repr(fsh.RadialShape(np.ones(16), (0, 0.5, 1))) == (
        "RadialShape(bandwidth=4, coefficients=<float64 16>, center=(0, 0.5, 1))"
    )
    assert repr(fsh.SHDOption(shells=8, frames=(0, 1.0))) == "SHDOption(shells=8, frames=(0, 1))"
    assert repr(MeshArrays(np.eye(3), [[0, 1, 2]])) == "MeshArrays(vertices=<float64 3×3>, triangles=<int64 1×3>)"


def test_no_value_holds_what_open3d_does_not_pickle() -> None:
    for cls in values():
        for field in dataclasses.fields(cls):
            assert "Any" not in str(field.type).replace("NDArray[Any]", "").replace("tuple[Any", ""), (cls, field.name)
    for one in examples().values():
        for field in dataclasses.fields(one):
            assert not type(getattr(one, field.name)).__module__.startswith("open3d")
