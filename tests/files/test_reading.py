from __future__ import annotations

import multiprocessing
import os
import stat
import struct
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from fsh3d_o3d._open3d import open3d
from fsh3d_o3d.errors import GeometryReadError, GeometryReadWarning
from fsh3d_o3d.files import reading
from fsh3d_o3d.files.formats import text as _parse_text
from fsh3d_o3d.files.reader_process import ReaderProcess
from fsh3d_o3d.files.reading import READABLE_FORMATS, read_geometry, read_geometry_arrays
from fsh3d_o3d.geometry.arrays import MeshArrays, PointArrays
from tests.files import mutations
from tests.files.exchange import FORMATS

FILES = mutations.valid_files()
MESHES = [name for name in FILES if "points" not in name and not name.endswith(".pcd")]
CLOUDS = [name for name in FILES if name not in MESHES]


@pytest.fixture
def write(tmp_path):
    def write(name: str, content: bytes | str) -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def read_here(path: Path) -> MeshArrays | PointArrays:
    return read_geometry_arrays(path, isolated=False)


def refuse(path: Path, reason: str) -> None:
    with pytest.raises(GeometryReadError, match=reason) as caught:
        read_here(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and len(message.splitlines()) == 1


def canonical(vertices: np.ndarray, triangles: np.ndarray) -> list:
    """Triangles as coordinates, each turned to begin with its smallest corner, sorted: free of any numbering."""
    corners = [[tuple(vertices[i].tolist()) for i in triangle] for triangle in triangles]
    return sorted(min(c[i:] + c[:i] for i in range(3)) for c in corners)


EXPECTED = canonical(mutations.VERTICES, mutations.TRIANGLES)


def test_samples_cover_every_readable_format():
    assert {Path(name).suffix for name in FILES} | FORMATS == set(READABLE_FORMATS)


@pytest.mark.parametrize("isolated", [True, False])
@pytest.mark.parametrize("name", MESHES)
def test_mesh_is_read_exactly(name, isolated, write):
    mesh = read_geometry_arrays(write(name, FILES[name].data), isolated=isolated)
    assert isinstance(mesh, MeshArrays)
    assert canonical(mesh.vertices, mesh.triangles) == EXPECTED
    assert len(mesh.vertices) == 6


@pytest.mark.parametrize("isolated", [True, False])
@pytest.mark.parametrize("name", CLOUDS)
def test_cloud_is_read_with_its_attributes(name, isolated, write):
    cloud = read_geometry_arrays(write(name, FILES[name].data), isolated=isolated)
    assert isinstance(cloud, PointArrays)
    np.testing.assert_array_equal(cloud.points, mutations.VERTICES)
    has_normals = name.endswith((".ply", ".xyzn", ".pcd"))
    has_colors = name.endswith((".ply", ".xyzrgb", ".pts", ".pcd"))
    assert (cloud.normals is not None, cloud.colors is not None) == (has_normals, has_colors)
    if has_normals:
        np.testing.assert_allclose(cloud.normals, mutations.NORMALS, atol=1e-7)  # float32 in some of the files
    if has_colors:
        np.testing.assert_allclose(cloud.colors, mutations.COLORS / 255, atol=1e-15)  # eight bits divided by 255


@pytest.mark.parametrize("name", [name for name in MESHES if name != "strips.ply"])  # trimesh finds no faces in it
def test_agrees_with_trimesh(name, write):
    path = write(name, FILES[name].data)
    other = trimesh.load_mesh(path, process=False)
    assert canonical(np.round(other.vertices, 6), other.faces) == EXPECTED


def test_extension_in_capitals_and_odd_file_names(write):
    path = write("a b\nü.OFF", FILES["plain.off"].data)
    assert len(read_geometry_arrays(path).triangles) == 8
    with pytest.raises(GeometryReadError, match=r"a b\\nc\.off: ") as caught:
        read_geometry_arrays(write("a b\nc.off", b"OFF\n"))
    assert "\n" not in str(caught.value)
    name = os.fsencode(path.parent) + b"/\xff.off"
    Path(os.fsdecode(name)).write_bytes(FILES["plain.off"].data)
    assert len(read_geometry_arrays(name).triangles) == 8


@pytest.mark.parametrize("isolated", [True, False])
def test_points_that_are_not_finite_are_left_out_with_a_note(isolated, write):
    path = write("n.xyz", "0 0 inf\n1e999 0 0\n1 1 1\n2 nan 0\n3 4 5\n")
    with pytest.warns(GeometryReadWarning, match="n.xyz: 3 of 5 points are NaN or infinite"):
        cloud = read_geometry_arrays(path, isolated=isolated)
    np.testing.assert_array_equal(cloud.points, [[1, 1, 1], [3, 4, 5]])


def test_vertices_that_no_face_uses_may_be_nan(write):
    path = write("n.off", "OFF 5 2 0\nnan 0 0\n0 0 0\n1 0 0\nnan 0 inf\n0 1 0\n3 1 2 4\n3 1 4 2\n")
    with pytest.warns(GeometryReadWarning, match="2 vertices that no face uses"):
        mesh = read_geometry_arrays(path)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 1]])


@settings(max_examples=300)
@given(st.lists(st.floats(allow_nan=False, width=64), min_size=3, max_size=30), st.sampled_from("rgef"))
def test_numbers_are_correctly_rounded(values, form):
    values = values[: len(values) // 3 * 3]
    words = [repr(v) if form == "r" else f"{v:.9{form}}" for v in values]
    text = "\n".join(" ".join(words[i : i + 3]) for i in range(0, len(words), 3)).encode()
    lines = _parse_text.TextLines.of(text)
    assert lines.span(0, len(lines)).values.tolist() == [float(word) for word in words]


@given(st.text(alphabet="0123456789+-.eE naif_x,\n", max_size=40))
def test_numbers_are_those_of_python_or_refused(text):
    tokens = text.split()
    try:
        values = _parse_text.TextLines.of(text.encode())
        parsed = values.span(0, len(values)).values.tolist()
    except GeometryReadError:
        # Python reads a few spellings more: "1_0" and none else.
        with pytest.raises(ValueError):
            [float(token.replace("_", "x")) for token in tokens]
    else:
        np.testing.assert_array_equal(parsed, [float(token) for token in tokens])


# ---- single formats ----


def test_polygons_become_fans_of_the_same_sense(write):
    vertices = "0 0 0\n2 0 0\n3 1 0\n2 2 0\n0 2 0\n"
    fans = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 3, 2], [4, 2, 1]]
    off = write("p.off", f"OFF\n5 3 0\n{vertices}5 0 1 2 3 4\n4 4 3 2 1 255 0.5 0\n2 0 1\n")
    obj = write("p.obj", "".join(f"v {line}\n" for line in vertices.splitlines()) + "f 1 2 3 4 5\nf 5/1 4/1 3 2//9\n")
    head = "element vertex 5\nproperty double x\nproperty double y\nproperty double z\nelement face 2\n"
    faces = (
        "property uchar flag\nproperty list uchar uint vertex_index\nproperty list uchar float texcoord\nend_header\n"
    )
    text = write("p.ply", f"ply\nformat ascii 1.0\n{head}{faces}{vertices}9 5 0 1 2 3 4 0\n9 4 4 3 2 1 2 .5 .5\n")
    points = np.array(vertices.split(), dtype=">f8").tobytes()
    polygons = struct.pack(">BB5IB", 9, 5, 0, 1, 2, 3, 4, 0) + struct.pack(">BB4IB2f", 9, 4, 4, 3, 2, 1, 2, 0.5, 0.5)
    binary = write("q.ply", f"ply\nformat binary_big_endian 1.0\n{head}{faces}".encode() + points + polygons)
    for path in (off, obj, text, binary):
        assert read_here(path).triangles.tolist() == fans, path.name


def test_obj_indices_count_from_the_front_or_back_of_their_line(write):
    path = write("m.obj", "v 0 0 0\nv 1 0 0 0.5\nv 0 1 0 1 0 0\nf -3 -2 -1\nv 0 0 1\nf 1 2 \\\n -1\nl 1 2\n")
    mesh = read_here(path)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 1, 3]]
    assert mesh.vertices[2].tolist() == [0, 1, 0]


def test_duplicate_vertices_stay_except_in_stl(write):
    off = write("d.off", "OFF 6 2 0\n" + "0 0 0\n1 0 0\n0 1 0\n" * 2 + "3 0 1 2\n3 3 5 4\n")
    assert len(read_here(off).vertices) == 6
    corner = np.float32(0.1)
    near = np.nextafter(corner, np.float32(1))
    facets = [(0, 0, 0, 1, 0, 0, 0, corner, 0), (0, 0, 0, 1, 0, 0, 0, near, 0), (-0.0, 0, 0, 1, 0, 0, 0, corner, 0)]
    stl = b"\0" * 80 + struct.pack("<I", 3) + b"".join(struct.pack("<12fH", 0, 0, 1, *f, 0) for f in facets)
    mesh = read_here(write("d.stl", stl))
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 1, 3], [0, 1, 2]]


def test_xyz_takes_unit_columns_as_normals_only(write):
    assert read_here(write("a.xyz", "0 0 1 0 0 1\n1 0 0 1 0 0.001\n")).normals is not None
    assert read_here(write("b.xyz", "0 0 1 0 0 1\n1 0 0 0 0 0\n")).normals is None
    assert read_here(write("c.xyz", "# x y z i\n0 0 1 7\r\n\r\n1 0 0 8\r\n")).points.tolist() == [[0, 0, 1], [1, 0, 0]]


def test_pcd_colors_packed_into_a_float(write):
    packed = struct.unpack("<f", struct.pack("<I", 0x3366CC))[0]
    head = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 8 8 8 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n"
    cloud = read_here(write("c.pcd", f"{head}DATA ascii\n1 2 0.1 {packed!r}\n"))
    assert cloud.points.tolist() == [[1, 2, 0.1]]
    np.testing.assert_allclose(cloud.colors, [[0.2, 0.4, 0.8]], atol=1e-15)  # 51, 102, 204 over 255


def test_lzf_long_and_overlapping_copies(write):
    points = np.repeat(np.arange(500, dtype="<f4"), 3).reshape(-1, 3)
    raw = points.T.tobytes()
    packed = mutations.lzf_compress(raw)
    head = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 500\nHEIGHT 1\nDATA binary_compressed\n"
    path = write("z.pcd", head + struct.pack("<II", len(packed), len(raw)) + packed)
    np.testing.assert_array_equal(read_here(path).points, points)


# ---- what is refused ----


@pytest.mark.parametrize("name", [name for name in FILES if not name.endswith((".obj", ".xyz", ".xyzn", ".xyzrgb"))])
def test_every_truncation_that_shows_is_an_error(name, write):
    """All but those formats have counts or end marks; text may still lose digits of its last number unnoticed."""
    data = FILES[name].data
    binary = b"\0" in data
    last_token = len(data) - 1 if binary else len(data.rstrip()) - len(data.split()[-1])
    for size in range(0, last_token + 1, 1 if len(data) < 600 else 7):
        with pytest.raises(GeometryReadError):
            read_here(write(name, data[:size]))


@pytest.mark.parametrize("name", ["plain.obj", "points.xyzn"])
def test_line_cut_short_is_an_error_where_nothing_is_counted(name, write):
    data = FILES[name].data
    with pytest.raises(GeometryReadError):
        read_here(write(name, data[: data.rstrip().rindex(b" ")]))


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("e.off", "", "the file is empty"),
        ("e.ply", "\n \n", "nothing but blanks"),
        ("z.off", "OFF 0 1 0\n3 0 1 2\n", "0 vertices and 1 faces"),
        ("z.obj", "vt 0 0\nv 0 0 0\nv 1 0 0\nv 0 1 0\n", "0 faces"),
        ("z.stl", b"\0" * 84, "nothing but blanks"),
        (
            "z.ply",
            "ply\nformat ascii 1.0\nelement vertex 0\nproperty int x\nproperty int y\nproperty int z\nend_header\n",
            "empty",
        ),
        ("n.off", "OFF 3 1 0\n0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "1 of 3 are NaN or infinite"),
        ("r.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "vertices 0 … 3, but there are vertices 0 … 2"),
        ("r.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 1 2\n", "refer to vertices -1"),
        ("r.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "counts from 1"),
        ("f.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n", "whole numbers, found 1.5"),
        ("b.off", "OFF 4000000000 4000000000 0\n0 0 0\n", "4000000000 vertices"),
        ("b.off", "OFF BINARY\n\1\2", "truncated: the numbers of vertices and faces are missing"),
        ("b.off", "4OFF 1 1 1\n", "1 vertices and 1 faces, .* but 0 lines follow"),
        ("l.off", "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 2\n", "but 5 lines follow"),
        ("t.off", "OFF 3 1 0\n0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n", "expected numbers, found 'x'"),
        ("w.obj", "v 0 0 0\nw 1 0 0\nv 0 1 0\nf 1 2 3\n", "'w' is not a keyword of OBJ"),
        ("s.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 /3\n", "begins with a slash"),
        ("u.obj", b"v 0 0 0\nv 1 0 \xff\xfe\nv 0 1 0\nf 1 2 3\n", r"found '\\xff\\xfe'"),
        (
            "b.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
            "truncated",
        ),
        (
            "b.pcd",
            b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2000000000\nHEIGHT 9\nDATA binary\n1234",
            "truncated",
        ),
        ("b.pts", "4000000000\n1 2 3\n", "announces 4000000000 points, but 1 follow"),
        ("b.stl", b"x" * 80 + b"\xff" * 4 + b"1" * 50, "announces 4294967295 triangles"),
        ("c.xyzrgb", "0 0 0 300 0 0\n", "colours must lie in 0 … 255"),
        ("x.xyzn", "0 0 0\n", "needs 6 numbers, found 3"),
        ("p.obj", FILES["text.ply"].data, "the content looks like PLY, not OBJ"),
        ("p.ply", FILES["text.stl"].data, "the content looks like STL, not PLY"),
        ("p.off", FILES["binary.stl"].data, "the content looks like STL, not OFF"),
        ("p.stl", FILES["plain.off"].data, "the content looks like OFF, not STL"),
        ("p.xyz", FILES["plain.obj"].data, "the content looks like OBJ, not XYZ"),
        ("p.glb", FILES["mesh.gltf"].data, "the content looks like GLTF, not GLB"),
        ("p.pcd", b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "the content looks like PNG, not PCD"),
        ("p.mesh", "x", r"'\.mesh' is not a format that is read; readable are \.off"),
        ("p", "x", "no extension"),
    ],
)
def test_refused_with_the_reason(name, content, reason, write):
    refuse(write(name, content), reason)


def test_reason_stays_short_whatever_a_file_calls_its_parts(write):
    head = (
        f"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nelement {'a' * 9000} 1\nproperty list int int i\n"
    )
    path = write("n.ply", head + "end_header\n1\n-2\n")
    refuse(path, "a list of -2 items in element aaa.*a…$")
    with pytest.raises(GeometryReadError) as caught:
        read_here(path)
    assert len(str(caught.value)) < len(str(path)) + 500


@pytest.mark.parametrize("isolated", [True, False])
def test_what_is_not_a_regular_file(tmp_path, isolated):
    link = tmp_path / "link.off"
    link.symlink_to(tmp_path / "nowhere.off")
    for missing in (link, tmp_path / "missing.ply"):
        with pytest.raises(FileNotFoundError, match=missing.name):
            read_geometry_arrays(missing, isolated=isolated)
    (tmp_path / "folder.off").mkdir()
    with pytest.raises(GeometryReadError, match="is not a regular file"):
        read_geometry_arrays(tmp_path / "folder.off", isolated=isolated)
    os.mkfifo(tmp_path / "pipe.off")
    assert stat.S_ISFIFO((tmp_path / "pipe.off").stat().st_mode)
    with pytest.raises(GeometryReadError, match="not a regular file"):
        read_geometry_arrays(tmp_path / "pipe.off", isolated=isolated)
    (tmp_path / "zero.off").symlink_to("/dev/zero")
    with pytest.raises(GeometryReadError, match="not a regular file"):
        read_geometry_arrays(tmp_path / "zero.off", isolated=isolated)


def test_arguments(write):
    path = write("a.off", FILES["plain.off"].data)
    with pytest.raises(ValueError, match="timeout"):
        read_geometry_arrays(path, timeout=0)
    with pytest.raises(ValueError, match="memory_limit"):
        read_geometry_arrays(path, memory_limit=0)
    with pytest.raises(TypeError):
        read_geometry_arrays(7)


def test_open3d_objects(write):
    o3d = open3d()
    mesh, cloud = write("m.off", FILES["plain.off"].data), write("c.pcd", FILES["binary.pcd"].data)
    assert isinstance(read_geometry(mesh), o3d.geometry.TriangleMesh)
    assert isinstance(read_geometry(mesh, kind="tensor"), o3d.t.geometry.TriangleMesh)
    points = read_geometry(cloud)
    assert isinstance(points, o3d.geometry.PointCloud) and points.has_normals() and points.has_colors()
    assert isinstance(read_geometry(cloud, kind="tensor", isolated=False), o3d.t.geometry.PointCloud)


# ---- the separate process ----


@pytest.fixture
def hostile():
    reader = ReaderProcess("tests.files.hostile_parser:read")
    yield lambda name, timeout=60.0: reader.read(f"/{name}.xyz", timeout=timeout, memory_limit=2**30).geometry
    reader.close()


@pytest.mark.parametrize(
    ("deed", "reason"),
    [
        ("crash", r"the reader died \(signal 11\)"),
        ("kill", r"the reader died \(signal 9\)"),
        ("exit", r"the reader died \(exit code 3\)"),
        ("raise", r"the reader died \(exit code 1\)"),
        ("garble", r"the reader died \(it broke the protocol\)"),
        ("hang", r"the reader was stopped after 0\.5 s"),
        ("allocate", "needs more memory than the reader is allowed"),
    ],
)
def test_caller_survives_its_reader(hostile, deed, reason):
    before = hostile("well").points[0, 0]
    with pytest.raises(GeometryReadError, match=rf"^/{deed}\.xyz: {reason}$"):
        hostile(deed, 0.5 if deed == "hang" else 60.0)
    after = hostile("well").points[0, 0]
    assert (before == after) == (deed == "allocate")  # replaced if it died, kept if it only refused


def test_reader_is_reused_and_its_prints_do_no_harm(hostile):
    first = hostile("well").points[0, 0]
    assert hostile("print").points[0, 0] == hostile("well").points[0, 0] == first != os.getpid()
    assert hostile("large").points.shape == (200_000, 3)


def test_reader_ended_from_outside_is_replaced(hostile):
    first = int(hostile("well").points[0, 0])
    os.kill(first, 9)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)  # else the request might still find it dying
    assert hostile("well").points[0, 0] not in (first, os.getpid())


def test_threads_share_the_reader(write):
    paths = [write(f"{i}.off", FILES["plain.off"].data.replace(b"1.25", b"%d.25" % i)) for i in range(24)]
    with ThreadPoolExecutor(8) as pool:
        meshes = list(pool.map(read_geometry_arrays, paths))
    assert [mesh.vertices[2, 1] for mesh in meshes] == [i + 0.25 for i in range(24)]


def _read_in_fork(path: str, queue: multiprocessing.Queue) -> None:
    queue.put((len(read_geometry_arrays(path).triangles), reading._reader._process.pid))


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_forked_process_starts_its_own_reader(write):
    path = str(write("a.off", FILES["plain.off"].data))
    read_geometry_arrays(path)
    own = reading._reader._process.pid
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_read_in_fork, args=(path, queue))
    child.start()
    triangles, other = queue.get(timeout=60)
    child.join()
    assert triangles == 8 and other != own
    assert len(read_geometry_arrays(path).triangles) == 8 and reading._reader._process.pid == own


def test_interrupt_while_reading_leaves_a_working_reader(hostile, monkeypatch):
    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    hostile("well")
    with monkeypatch.context() as patch:
        patch.setattr("fsh3d_o3d.files.reader_process._receive", interrupted)
        with pytest.raises(KeyboardInterrupt):
            hostile("large")
    assert hostile("well").points.shape == (1, 3)


def test_closing_does_not_wait_for_a_hanging_reader():
    reader = ReaderProcess("tests.files.hostile_parser:read")
    errors: list[str] = []

    def hang() -> None:
        try:
            reader.read("/hang.xyz", timeout=300, memory_limit=2**30)
        except GeometryReadError as error:
            errors.append(str(error))

    thread = threading.Thread(target=hang)
    thread.start()
    while reader._process is None:
        pass
    reader.close()
    thread.join(timeout=60)
    assert not thread.is_alive() and "the reader died" in errors[0]


def test_no_process_is_left_behind_and_none_loads_open3d(write):
    path = write("a.off", FILES["plain.off"].data)
    program = (
        "import sys; from fsh3d_o3d.files import reading\n"
        f"reading.read_geometry_arrays({str(path)!r}); pid = reading._reader._process.pid\n"
        "maps = open(f'/proc/{pid}/maps').read()\n"
        "print(pid, any(name in maps for name in ('/open3d', '/scipy/', '/ducc0')), 'open3d' in sys.modules)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    pid, in_child, in_parent = done.stdout.split()
    assert (in_child, in_parent) == ("False", "False")
    assert not Path(f"/proc/{pid}").exists()
