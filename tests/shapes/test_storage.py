"""Shapes in files: equal to the last bit, checked on loading, never pickled."""

from __future__ import annotations

import io
import os
import zipfile

import numpy as np
import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.jobs.descriptor_cache import descriptor_key
from fsh3d_o3d.shapes import write_arrays


@pytest.fixture
def shape(rng):
    return fsh.RadialShape(rng.standard_normal(49), rng.standard_normal(3), "tensor")


def rewritten(path, changes):
    """The file at ``path`` with some arrays replaced (None removes one)."""
    with np.load(path) as file:
        arrays = dict(file)
    arrays.update(changes)
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


def test_what_is_saved_comes_back(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    again = fsh.load_shape(tmp_path / "x.npz")
    assert isinstance(again, fsh.RadialShape)
    assert again.coefficients.tobytes() == shape.coefficients.tobytes()
    assert again.center.tobytes() == shape.center.tobytes()
    assert again.kind == "tensor"
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_same_shape_same_bytes(shape, tmp_path):
    shape.save(tmp_path / "a.npz")
    shape.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_numpy_reads_it_too(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz", allow_pickle=False) as file:
        assert np.array_equal(file["coefficients"], shape.coefficients)
        assert str(file["kind"]) == "RadialShape"


def test_wrong_extension_is_refused(shape, tmp_path):
    with pytest.raises(ValueError, match=r"saved as \.npz"):
        shape.save(tmp_path / "x.ply")


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        fsh.load_shape(tmp_path / "none.npz")


@pytest.mark.parametrize(
    "changes",
    [
        {"coefficients": np.zeros(48)},
        {"coefficients": np.full(49, np.nan)},
        {"coefficients": np.zeros((7, 7))},
        {"coefficients": np.array(["a"] * 49)},
        {"coefficients": np.zeros(0)},
        {"coefficients": None},
        {"center": np.zeros(2)},
        {"center": None},
        {"geometry": np.array("gas")},
        {"kind": np.array("Potato")},
        {"kind": None},
        {"format": np.array("other")},
        {"format": None},
        {"version": np.array(0)},
        {"version": np.array("new")},
    ],
    ids=repr,
)
def test_malformed_files_are_refused(shape, tmp_path, changes):
    shape.save(tmp_path / "x.npz")
    with pytest.raises(GeometryReadError, match=r"x\.npz"):
        fsh.load_shape(rewritten(tmp_path / "x.npz", changes))


def test_newer_format_says_so(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    with pytest.raises(GeometryReadError, match="upgrade"):
        fsh.load_shape(rewritten(tmp_path / "x.npz", {"version": np.array(99)}))


def test_every_truncation_is_refused(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    whole = (tmp_path / "x.npz").read_bytes()
    for length in range(0, len(whole), 37):
        (tmp_path / "x.npz").write_bytes(whole[:length])
        with pytest.raises(GeometryReadError):
            fsh.load_shape(tmp_path / "x.npz")


def test_flipped_bytes_never_crash(shape, tmp_path, rng):
    shape.save(tmp_path / "x.npz")
    whole = bytearray((tmp_path / "x.npz").read_bytes())
    refused = 0
    for position in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        (tmp_path / "x.npz").write_bytes(bytes(damaged))
        try:
            fsh.load_shape(tmp_path / "x.npz")
        except GeometryReadError:
            refused += 1
    assert refused > 150  # the checksums of the archive catch what hits the arrays; dates and attributes do not matter


def test_pickles_are_refused(shape, tmp_path):
    shape.save(tmp_path / "x.npz")
    with zipfile.ZipFile(tmp_path / "x.npz") as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    pickled = io.BytesIO()
    np.save(pickled, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    entries["center.npy"] = pickled.getvalue()
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    with pytest.raises(GeometryReadError):
        fsh.load_shape(tmp_path / "x.npz")


def archive_of(path, entries, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in entries:
            archive.writestr(name, data)
    return path


def npy(array, shape=None):
    """An array as ``.npy``, which may announce another shape."""
    stream = io.BytesIO()
    header = np.lib.format.header_data_from_array_1_0(array)
    np.lib.format.write_array_header_1_0(stream, {**header, "shape": shape or array.shape})
    return stream.getvalue() + array.tobytes()


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr("fsh3d_o3d.shapes.storage._MAXIMUM_BYTES", 10**6)
    path = archive_of(tmp_path / "x.npz", [("coefficients.npy", bytes(10**7))])
    with pytest.raises(GeometryReadError, match="would take more than"):
        fsh.load_shape(path)
    monkeypatch.setattr("fsh3d_o3d.shapes.storage._MAXIMUM_BYTES", 10**9)
    monkeypatch.setattr("fsh3d_o3d._npz._FREE_BYTES", 10**6)
    with pytest.raises(GeometryReadError, match=r"x\.npz: .*\(\d+ bytes unpack to 10000000\)"):
        fsh.load_shape(path)


def test_what_packs_well_is_saved_so_that_it_is_read(tmp_path, monkeypatch):
    """Coefficients that a filter has made zero."""
    monkeypatch.setattr("fsh3d_o3d._npz._FREE_BYTES", 10**4)
    coefficients = np.zeros(64**2)
    coefficients[0] = 1
    fsh.RadialShape(coefficients, np.zeros(3)).save(tmp_path / "x.npz")
    assert fsh.load_shape(tmp_path / "x.npz").coefficients.tobytes() == coefficients.tobytes()


@pytest.mark.parametrize("shape", [(10**10,), (-1,), (2**62, 4), (7,), (10**400,)])
def test_headers_that_lie_ask_for_no_memory(shape, tmp_path):
    path = archive_of(tmp_path / "x.npz", [("coefficients.npy", npy(np.arange(9.0), shape))])
    with pytest.raises(GeometryReadError, match="not a shape file"):
        fsh.load_shape(path)


def test_directories_that_lie_are_refused(tmp_path):
    data = npy(np.arange(9.0))
    many = archive_of(tmp_path / "x.npz", [(f"{number}.npy", data) for number in range(65)])
    with pytest.raises(GeometryReadError, match="65 entries"):
        fsh.load_shape(many)
    with pytest.warns(UserWarning, match="Duplicate name"):
        twice = archive_of(tmp_path / "x.npz", [("a.npy", data), ("a.npy", data)])
    with pytest.raises(GeometryReadError, match="overlap"):
        fsh.load_shape(twice)
    whole = bytearray(archive_of(tmp_path / "x.npz", [("a.npy", data)]).read_bytes())
    whole[-10:-6] = (2**31).to_bytes(4, "little")  # length of the directory
    (tmp_path / "x.npz").write_bytes(whole)
    with pytest.raises(GeometryReadError, match="entries"):
        fsh.load_shape(tmp_path / "x.npz")


def test_what_is_no_regular_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.npz")
    (tmp_path / "zero.npz").symlink_to("/dev/zero")
    (tmp_path / "folder.npz").mkdir()
    for name in ("pipe", "zero", "folder"):
        with pytest.raises(GeometryReadError, match=rf"{name}\.npz: is not a regular file"):
            fsh.load_shape(tmp_path / f"{name}.npz")
        with pytest.raises(OSError, match="is not a regular file"):
            fsh.read_classification(tmp_path / f"{name}.npz")
        assert descriptor_key(tmp_path / f"{name}.npz", "") is None


@pytest.mark.parametrize("shape", [fsh.RadialShape, fsh.ShellShape, fsh.ConformalShape])
def test_a_shape_is_geometry_wherever_that_is_asked_for(shape, tmp_path):
    vertices, triangles = fsh.icosphere(4)
    path = tmp_path / "egg.NPZ"
    encoded = shape.from_geometry((vertices * [1.0, 1.2, 1.5], triangles), 4, attributes={"height": vertices[:, 2]})
    encoded.save(path)
    mesh = encoded.mesh_arrays()[0]
    assert fsh.from_any(path) == mesh
    assert len(fsh.read_geometry(path).triangles) == len(mesh.triangles)
    assert fsh.surface_error(path, (vertices * [1.0, 1.2, 1.5], triangles), samples=1000).relative().rmse < 0.2
    index = fsh.ShapeIndex.open(tmp_path / "index", create=True)
    assert index.add_files([path]).added == 1
    assert index.query(path)[0].path == str(path)


def test_other_npz_files_are_no_geometry(tmp_path):
    np.savez(tmp_path / "a.npz", vertices=np.eye(3))
    with pytest.raises(GeometryReadError, match=r"a\.npz: an \.npz, but not one of fsh3d_o3d"):
        fsh.from_any(tmp_path / "a.npz")
    write_arrays(tmp_path / "f.npz", "features", {"features": np.eye(3)})
    with pytest.raises(GeometryReadError, match="it holds features"):
        fsh.from_any(tmp_path / "f.npz")
    (tmp_path / "t.npz").write_bytes((tmp_path / "f.npz").read_bytes()[:-30])
    with pytest.raises(GeometryReadError, match=r"t\.npz: .*(damaged|its end is missing)"):
        fsh.read_geometry(tmp_path / "t.npz")
