"""Labels and values of voxels: their surfaces, where they lie, and what is refused."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.volumes import surfaces_of
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry import EdgeTable, PointArrays
from tests.files.mutations import VERTICES
from tests.files.volumes import SHAPE, SPACING, labels, nifti, nrrd, values

BALL = 4 / 3 * np.pi * 6**3
PLAIN = np.hstack([np.diag(SPACING), np.zeros((3, 1))])


def part(found, number: int):
    """Vertices and triangles of a part."""
    before = found.parts[:number]
    first, row = sum(part.points for part in before), sum(part.triangles for part in before)
    one = found.parts[number]
    triangles = found.geometry.triangles[row : row + one.triangles] - first
    return found.geometry.vertices[first : first + one.points], triangles


def volume(vertices, triangles) -> float:
    return float(np.linalg.det((vertices - vertices.mean(axis=0))[triangles]).sum() / 6)


def check_labels(found, placement: np.ndarray = PLAIN, names: tuple[str, ...] = ("label 3", "label 7")) -> None:
    """Each label has a closed surface of its own, of its size and where it belongs."""
    assert tuple(part.name for part in found.parts) == names
    scale = abs(np.linalg.det(placement[:, :3])) / np.prod(SPACING)
    ball, box = part(found, 0), part(found, 1)
    for vertices, triangles in (ball, box):
        assert (EdgeTable(triangles).faces == 2).all() and EdgeTable(triangles).balanced
        assert len(np.unique(triangles)) == len(vertices)
    # A ball of 12 x 8 x 3 voxels' half axes: marching cubes cut 6 % of its volume off.
    assert volume(*ball) == pytest.approx(scale * BALL, rel=0.08)
    np.testing.assert_allclose(box[0].mean(axis=0), placement @ [35.5, 22.5, 3.5, 1], atol=1e-5)
    np.testing.assert_allclose(ball[0].mean(axis=0), placement @ [14, 14, 6, 1], atol=1e-5)
    assert volume(*box) == pytest.approx(scale * 192 * np.prod(SPACING), rel=0.1)  # its edges are cut off
    corner = np.abs(box[0] - placement @ [35.5, 22.5, 3.5, 1]) @ np.abs(np.linalg.inv(placement[:, :3])).T
    if np.array_equal(placement, PLAIN):
        np.testing.assert_allclose(corner.max(axis=0), [4, 3, 2], atol=1e-5)  # voxels are boxes around their places


def test_labels_of_each_format(tmp_path):
    head, body = nrrd(labels())
    check_labels(parse_content("/a.nii", nifti(labels())))
    check_labels(parse_content("/a.nrrd", head + body))
    head, body = nrrd(labels(), "gzip")
    check_labels(parse_content("/a.nrrd", head + body))
    head, body = nrrd(labels(), "ascii")
    check_labels(parse_content("/a.nrrd", head + body))
    buffer = io.BytesIO()
    np.save(buffer, labels())
    found = parse_content("/a.npy", buffer.getvalue())
    check_labels(found, np.eye(3, 4))


def test_the_places_of_voxels_follow_the_header():
    rng = np.random.default_rng(1)
    affine = np.vstack([np.hstack([rng.normal(size=(3, 3)), [[100], [-50], [20]]]), [0, 0, 0, 1]])
    affine[:, 0] *= -np.sign(np.linalg.det(affine))  # mirrored, as most scans are: outside stays outside
    check_labels(parse_content("/a.nii", nifti(labels(), affine.astype("<f4").astype(float))), affine[:3])


@pytest.mark.parametrize("coded", ["sform", "qform", "none"])
@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("order", ["<", ">"])
def test_nibabel_agrees_on_places_and_values(coded, version, order):
    nibabel = pytest.importorskip("nibabel", reason="nibabel, a second opinion, is not installed")
    affine = np.eye(4)
    affine[:3, :3] = np.array([[0, -1, 0], [1, 0, 0], [0, 0, -1]]) * SPACING  # a rotation and a flip
    affine[:3, 3] = [10, 20, 30]
    kind = (nibabel.Nifti1Image, nibabel.Nifti2Image)[version - 1]
    image = kind(labels().astype(np.int16), affine, header=kind.header_class(endianness=order))
    image.set_sform(affine, int(coded == "sform"))
    image.set_qform(affine, int(coded == "qform"))
    image.header.set_xyzt_units("mm")
    image.header.set_slope_inter(1, 0)
    data = image.to_bytes()
    expected = (
        nibabel.Nifti1Image.from_bytes(data).affine if version == 1 else nibabel.Nifti2Image.from_bytes(data).affine
    )
    if coded == "none":
        expected = np.diag([*SPACING, 1])  # nibabel puts the origin into the middle where there is no transform
    check_labels(parse_content("/a.nii", data), np.asarray(expected[:3], dtype=float))


def test_values_are_cut_at_otsus_threshold():
    for name, data in (("a.nii", nifti(values())), ("a.nrrd", b"".join(nrrd(values())))):
        found = parse_content(f"/{name}", data)
        level = float(found.parts[0].name.split()[2])
        assert found.notes == (f"the surface is where its values reach {level:.6g}, chosen by Otsu's method",)
        distance = np.linalg.norm(found.geometry.vertices - [7, 10.5, 12], axis=1)
        inside = np.abs(found.geometry.vertices / SPACING - (np.array(SHAPE) - 1) / 2) < np.array(SHAPE) / 2 - 0.6
        np.testing.assert_allclose(
            distance[inside.all(axis=1)], (100 - level) / 10, atol=0.05
        )  # between voxels of 2 mm
        assert (EdgeTable(found.geometry.triangles).faces == 2).all()


def test_slope_and_unit_of_nifti():
    data = bytearray(nifti(values()))
    struct.pack_into("<ff", data, 112, 2.0, 5.0)
    data[123] = 1  # metres
    found = parse_content("/a.nii", bytes(data))
    plain = parse_content("/a.nii", nifti(values()))
    level, before = (float(one.parts[0].name.split()[2]) for one in (found, plain))
    assert level == pytest.approx(2 * before + 5, rel=1e-5)
    np.testing.assert_allclose(found.geometry.vertices, plain.geometry.vertices * 1000, rtol=1e-4)


def test_pynrrd_writes_what_is_read(tmp_path):
    pynrrd = pytest.importorskip("nrrd", reason="pynrrd, a second opinion, is not installed")
    head = {"space directions": np.diag(SPACING), "space": "RAS", "encoding": "gzip"}
    head |= {"Segment0_Name": "kidney", "Segment0_LabelValue": "3", "Segment1_Name": "box", "Segment1_LabelValue": "7"}
    pynrrd.write(str(tmp_path / "a.seg.nrrd"), labels(), head)
    check_labels(parse_content("/a.seg.nrrd", (tmp_path / "a.seg.nrrd").read_bytes()), names=("kidney", "box"))
    pynrrd.write(str(tmp_path / "b.nhdr"), labels().astype(np.int16), head | {"encoding": "raw"}, detached_header=True)
    from fsh3d_o3d.files import read_geometry_file

    check_labels(read_geometry_file(tmp_path / "b.nhdr"), names=("kidney", "box"))


def test_stacks_of_tiff():
    tifffile = pytest.importorskip("tifffile", reason="tifffile is not installed: the extra of this format is absent")
    pages = np.transpose(labels())
    tags = {
        "imagej": {"imagej": True, "resolution": (2, 4 / 3), "metadata": {"spacing": 2.0, "unit": "mm", "axes": "ZYX"}},
        "ome": {
            "ome": True,
            "metadata": {
                "axes": "ZYX",
                "PhysicalSizeX": 500.0,
                "PhysicalSizeY": 750.0,
                "PhysicalSizeZ": 2000.0,
            },
        },
    }
    for name, how in tags.items():
        for compression in (None, "zlib"):
            buffer = io.BytesIO()
            if name == "imagej" and compression:
                continue
            tifffile.imwrite(buffer, pages, compression=compression, **how)
            check_labels(parse_content("/a.tif", buffer.getvalue()))
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, pages, resolution=(20, 20), resolutionunit="CENTIMETER")
    found = parse_content("/a.tif", buffer.getvalue())
    assert found.notes == ("the distance of its pages is not given; they were taken to be as far apart as its columns",)
    check_labels(found, np.hstack([np.eye(3) * 0.5, np.zeros((3, 1))]))
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, np.zeros((8, 8, 3), dtype=np.uint8), photometric="rgb")
    with pytest.raises(GeometryReadError, match="its pictures have colours"):
        parse_content("/a.tif", buffer.getvalue())
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, pages[3])
    with pytest.raises(GeometryReadError, match="a picture of 30 x 40, no stack"):
        parse_content("/a.tif", buffer.getvalue())


def test_points_of_numpy():
    buffer = io.BytesIO()
    np.save(buffer, VERTICES.astype(">f4"))
    found = parse_content("/a.npy", buffer.getvalue()).geometry
    assert found == PointArrays(VERTICES)


def test_what_is_taken_for_labels():
    def parts(voxels: np.ndarray, **how) -> int | str:
        source = Source(b"")
        surfaces_of(source, voxels, np.eye(3, 4), **how)
        return len(source.parts) if not source.notes else "values"

    noise = np.random.default_rng(2).integers(0, 200, SHAPE).astype(np.uint8)
    assert parts(labels()) == parts(labels().astype(float)) == parts(labels().astype(np.int64) * 1000) == 2
    assert parts(labels() > 0) == 1
    assert parts(noise) == parts(np.rint(values())) == "values"
    assert parts(np.rint(values()) + 200, labels=True) > 50
    assert parts(labels() + np.int16(5)) == 2  # the smallest is the background where there is no 0


def test_refused_with_the_reason():
    def refuse(name: str, data: bytes, reason: str) -> None:
        with pytest.raises(GeometryReadError, match=reason):
            parse_content(f"/{name}", data)

    def npy(array) -> bytes:
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=True)
        return buffer.getvalue()

    refuse("a.nii", nifti(labels())[:-1], "truncated or damaged: 40 x 30 x 14 voxels need 16800 bytes")
    refuse("a.nii", nifti(labels()).replace(b"n+1\0", b"ni1\0"), "in another file, .img")
    refuse("a.nii", nifti(np.zeros(SHAPE, dtype=np.uint8)), "all its voxels are 0")
    refuse("a.nii", nifti(np.zeros((4, 4, 4, 2), dtype=np.uint8)), r"several volumes \(4 x 4 x 4 x 2\)")
    refuse("a.nii", nifti(labels(), np.zeros((3, 4))), "its voxels have no size")
    head, body = nrrd(labels())
    refuse("a.nrrd", head + body[:-1], "16800 voxels need 16800 bytes, but 16799 follow")
    refuse("a.nrrd", head.replace(b"uint8", b"block") + body, "lacks, or misspells, 'block'")
    refuse("a.nrrd", head.replace(b"raw", b"zrl") + body, "encoding 'zrl', which is not read")
    refuse("a.nrrd", head.replace(b"40 30", b"40000000000 30") + body, "its sizes are")
    refuse("a.nhdr", nrrd(labels(), name="../secret.raw")[0], "only plain names in the same folder")
    refuse("a.nhdr", nrrd(labels(), name="a%03d.raw 1 9 1")[0], "in several other files")
    refuse("a.npy", npy(np.array([object()])), "no real numbers but 'object'")
    refuse("a.npy", npy(np.zeros((5, 7))), "an array or picture of 5 x 7, no volume")
    refuse("a.npy", npy(labels())[:-3], "truncated or damaged: an array of 40 x 30 x 14")
    refuse("a.npy", npy(labels()).replace(b"(40, 30", b"(10**9, 3"), "its header cannot be read")
