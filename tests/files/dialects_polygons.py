"""OFF, OBJ and PLY as programs write them."""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterator

import numpy as np

from tests.files.dialects import NOT_COUNTED, POINTS, Dialect, encodings, line_ends, rows, spellings
from tests.files.mutations import COLORS, NORMALS, TRIANGLES, VERTICES, valid_files

_FACES = rows(TRIANGLES, "3 %d %d %d")
_BOX = "0 0 0\n1 0 0\n1 2 0\n0 2 0\n0 0 3\n1 0 3\n1 2 3\n0 2 3\n"
_BOX_FACES = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
_NO_MARK = "it wants a byte-order mark"
_LINES = "it wants every vertex and every face on a line of its own"
_SIZE = "it wants the exact size"
_LOWER = "it wants lower case"


def polygon_dialects() -> Iterator[Dialect]:
    """Yield the octahedron, a box of polygons, and clouds."""
    yield from _off()
    yield from _obj()
    yield from _ply_text()
    yield from _ply_binary()


def _off() -> Iterator[Dialect]:
    plain = f"OFF\n6 8 12\n{POINTS}{_FACES}"
    normals = rows(np.hstack([VERTICES, NORMALS]), "%r %r %r %.9f %.9f %.9f")
    colors = rows(np.hstack([VERTICES, COLORS]), "%r %r %r %d %d %d 255")
    both = rows(np.hstack([VERTICES, NORMALS, COLORS]), "%r %r %r %.9f %.9f %.9f %d %d %d 255")
    textured = POINTS.replace("\n", " 0.25 0.75\n")
    four = POINTS.replace("\n", " 1\n")
    variants = {
        **line_ends(plain.encode()),
        **encodings(plain.encode()),
        **{name: f"OFF\n6 8 12\n{points}{_FACES}".encode() for name, points in spellings(POINTS).items()},
        "glued": plain.replace("OFF\n", "OFF").encode(),
        "one line": plain.replace("OFF\n", "OFF ").encode(),
        "edges left out": plain.replace("6 8 12", "6 8").encode(),
        "no edges": plain.replace("6 8 12", "6 8 0").encode(),
        "comments": f"OFF # by hand\n# a shape\n6 8 12\n# points\n{POINTS}# faces\n{_FACES}# end\n".encode(),
        "comments behind": plain.replace("\n", " # a line\n").encode(),
        "latin comment": "# größer\n".encode("latin-1") + plain.encode(),
        "blank lines": plain.replace("\n", "\n\n").encode(),
        "indented": re.sub("(?m)^(?=.)", "\t ", plain).encode(),
        "counts on lines": f"OFF\n6\n8\n12\n{POINTS}{_FACES}".encode(),
        "several on a line": ("OFF\n6 8 12\n" + POINTS.replace("\n", " ") + "\n" + _FACES).encode(),
        "faces over lines": f"OFF\n6 8 12\n{POINTS}{_FACES.replace(' ', chr(10))}".encode(),
        "all on one line": plain.replace("\n", " ").encode(),
        "no keyword": f"6 8 12\n{POINTS}{_FACES}".encode(),
        "face colours": f"OFF\n6 8 12\n{POINTS}{_FACES.replace(chr(10), ' 255 0 0' + chr(10))}".encode(),
        "face fractions": f"OFF\n6 8 12\n{POINTS}{_FACES.replace(chr(10), ' 0.5 0.25 0 1' + chr(10))}".encode(),
        "face map": f"OFF\n6 8 12\n{POINTS}{_FACES.replace(chr(10), ' 3' + chr(10))}".encode(),
        "normals": f"NOFF\n6 8 12\n{normals}{_FACES}".encode(),
        "colours": f"COFF\n6 8 12\n{colors}{_FACES}".encode(),
        "colours and normals": f"CNOFF\n6 8 12\n{both}{_FACES}".encode(),
        "normals and colours": f"NCOFF\n6 8 12\n{both}{_FACES}".encode(),
        "textured": f"STOFF\n6 8 12\n{textured}{_FACES}".encode(),
        "four": f"4OFF\n6 8 12\n{four}{_FACES}".encode(),
        "dimension": f"nOFF\n3\n6 8 12\n{POINTS}{_FACES}".encode(),
        "blanks behind": plain.encode() + b"\n\n  \n",
        "zeros behind": plain.encode() + bytes(64),
        "unused vertex": plain.replace("6 8 12", "7 8 12").replace(_FACES, f"9 9 9\n{_FACES}").encode(),
        "edge": plain.replace("6 8 12", "6 9 12").encode() + b"2 0 1\n",
    }
    wrong = {
        "utf16none": _NO_MARK,
        **dict.fromkeys(("counts on lines", "several on a line", "faces over lines", "all on one line"), _LINES),
        "no keyword": "it takes the counts for the keyword",
        "dimension": "it takes the dimension for the counts",
    }
    for name, data in variants.items():
        # What stands behind the index of the last corner tells nothing that is needed.
        tail = len(data) - len(data.rstrip(b"\0 \n")) if name.endswith("behind") else 0
        yield Dialect(f"{name}.off", data, tail=tail, trimesh=wrong.get(name, ""))
    faces = "".join(f"4 {' '.join(map(str, face))}\n" for face in _BOX_FACES)
    yield Dialect("box.off", f"OFF\n8 6 12\n{_BOX}{faces}".encode(), "box")
    binary = struct.pack(">3i", 6, 8, 12) + VERTICES.astype(">f4").tobytes()
    binary += b"".join(struct.pack(">5i", 3, *corners, 0) for corners in TRIANGLES.tolist())
    yield Dialect("binary.off", b"OFF BINARY\n" + binary, trimesh="it reads text only")
    yield Dialect("points.off", f"OFF\n6 0 0\n{POINTS}".encode(), "cloud")


def _obj() -> Iterator[Dialect]:
    vertices = re.sub("(?m)^(?=.)", "v ", POINTS)
    faces = rows(TRIANGLES + 1, "f %d %d %d")
    plain = vertices + faces
    thrice = np.repeat(TRIANGLES + 1, 3, axis=1)
    twice = np.repeat(TRIANGLES + 1, 2, axis=1)
    behind = "vt 0 0\nvn 0 0 1\n" * 6
    variants = {
        **line_ends(plain.encode()),
        **encodings(plain.encode()),
        **{name: (points + faces).encode() for name, points in spellings(vertices).items()},
        "slashes": (vertices + behind + rows(thrice, "f %d/%d/%d %d/%d/%d %d/%d/%d")).encode(),
        "one slash": (vertices + behind + rows(twice, "f %d/%d %d/%d %d/%d")).encode(),
        "two slashes": (vertices + behind + rows(twice, "f %d//%d %d//%d %d//%d")).encode(),
        "slash behind": (vertices + rows(TRIANGLES + 1, "f %d/ %d/ %d/")).encode(),
        "slashes behind": (vertices + rows(TRIANGLES + 1, "f %d// %d// %d//")).encode(),
        "negative": (vertices + rows(TRIANGLES - 6, "f %d %d %d")).encode(),
        "mixed order": "".join(
            f"{a}\n{b}" for a, b in itertools.zip_longest(vertices.splitlines(), ["\n"] * 6, fillvalue="")
        ).encode()
        + faces.encode(),
        "faces first": (faces + vertices).encode(),
        "comments": ("# by hand\n" + plain.replace("\n", " # a line\n")).encode(),
        "latin comment": "# größer\no Größe\n".encode("latin-1") + plain.encode(),
        "groups": ("o a\ng b c\ns off\nusemtl red\n" + vertices + "s 1\n" + faces).encode(),
        "library": ("mtllib a file.mtl\n" + plain).encode(),
        "weights": (vertices.replace("\n", " 1\n") + faces).encode(),
        "colours": (vertices.replace("\n", " 1 0 0.5\n") + faces).encode(),
        "continued": (vertices + rows(TRIANGLES + 1, "f %d %d \\\n %d")).encode(),
        "tabs": plain.replace(" ", "\t").encode(),
        "blank lines": plain.replace("\n", "\n\n").encode(),
        "indented": re.sub("(?m)^(?=.)", "  ", plain).encode(),
        "blanks behind": plain.replace("\n", "   \n").encode(),
        "upper": (vertices.upper() + faces.upper()).encode(),
        "fo": (vertices + faces.replace("f ", "fo ")).encode(),
        "lines": (plain + "l 1 2 3\np 1 2\n").encode(),
        "curves": (plain + "vp 0.5 0.5\ncstype bezier\ndeg 3\n").encode(),
        "creases": (plain + "t crease 2/1/0 0 1 2.0\n").encode(),
        "skin": (plain + "vw 0 1 0.5 1 0.5\n").encode(),
        "materials inside": (plain + "newmtl red\nKd 1 0 0\n").encode(),
        "junk first": ("$ a shape\n" + plain).encode(),
        "two corners": (plain + "f 1 2\n").encode(),
        "one corner": (plain + "f 1\n").encode(),
        "unused vertex": (vertices + "v 9 9 9\n" + faces).encode(),
        "no last line end": plain.rstrip().encode(),
        "zeros behind": plain.encode() + bytes(64),
    }
    wrong = {
        "cr": "it wants line ends of Unix or Windows",
        "utf8mark": "it takes the mark for part of the first keyword",
        "utf16none": _NO_MARK,
        "comments": "it reads what stands behind #",
        **dict.fromkeys(("tabs", "indented", "upper", "fo"), "it wants 'v ' and 'f ' at the beginning of a line"),
    }
    for name, data in variants.items():
        yield Dialect(f"{name}.obj", data, trimesh=wrong.get(name, ""), cut=NOT_COUNTED)
    box = re.sub("(?m)^(?=.)", "v ", _BOX)
    quads = "".join(f"f {' '.join(str(corner + 1) for corner in face)}\n" for face in _BOX_FACES)
    yield Dialect("box.obj", (box + quads).encode(), "box", cut=NOT_COUNTED)
    for name, more in (
        ("points", ""),
        ("named points", "p 1 2 3 4 5 6\n"),
        ("point a line", "p 1\np 2\np 3\np 4\np 5\np 6\n"),
    ):
        text = vertices + more
        yield Dialect(f"{name}.obj", text.encode(), "cloud", cut=NOT_COUNTED)


def _ply_head(
    kind: str, *, place: str = "float", count: str = "uchar", index: str = "int", name: str = "vertex_indices"
) -> str:
    places = "".join(f"property {place} {axis}\n" for axis in "xyz")
    return (
        f"ply\nformat {kind} 1.0\nelement vertex 6\n{places}element face 8\n"
        f"property list {count} {index} {name}\nend_header\n"
    )


def _ply_text() -> Iterator[Dialect]:
    head = _ply_head("ascii")
    plain = head + POINTS + _FACES
    variants = {
        **line_ends(plain.encode()),
        **encodings(plain.encode()),
        **{name: (head + points + _FACES).encode() for name, points in spellings(POINTS).items()},
        "vertex_index": plain.replace("vertex_indices", "vertex_index").encode(),
        "comments": plain.replace("element vertex", "comment by hand\nobj_info a shape\nelement vertex").encode(),
        "latin comment": plain.replace("element vertex", "comment größer\nelement vertex").encode("latin-1"),
        "junk header": plain.replace("element vertex", "Created by a program\nelement vertex").encode(),
        "comment body": plain.replace(head, head + "comment in the body\n").encode(),
        "upper names": re.sub("(?m)float ([xyz])$", lambda found: f"float {found[1].upper()}", plain).encode(),
        "faces on a line": (head + POINTS + _FACES.replace("\n", " ") + "\n").encode(),
        "numbers on lines": (head + POINTS.replace(" ", "\n") + _FACES.replace(" ", "\n")).encode(),
        "blank lines": (head + (POINTS + _FACES).replace("\n", "\n\n")).encode(),
        "indented": (head + re.sub("(?m)^(?=.)", "  ", POINTS + _FACES)).encode(),
        "version": plain.replace("format ascii 1.0", "format  ascii  1.0 ").encode(),
        "double": plain.replace("property float", "property double").encode(),
        "float32": plain.replace("property float", "property float32").replace("uchar int", "uint8 int32").encode(),
        "edges": (
            plain.replace("end_header", "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header")
            + "0 1\n"
        ).encode(),
        "material": (
            plain.replace("end_header", "element material 1\nproperty uchar red\nend_header") + "7\n"
        ).encode(),
        "no material": plain.replace("end_header", "element material 0\nproperty uchar red\nend_header").encode(),
        "blanks behind": (plain + "\n \n").encode(),
        "zeros behind": plain.encode() + bytes(32),
    }
    wrong = {
        "cr": "it wants line ends of Unix or Windows",
        **dict.fromkeys(("utf16le", "utf16be", "utf16none", "utf32"), "it decodes only UTF-8"),
        "latin comment": "it decodes only UTF-8",
        **dict.fromkeys(("comment body", "blank lines", "zeros behind"), _LINES),
        **dict.fromkeys(("faces on a line", "numbers on lines"), _LINES),
        "upper names": _LOWER,
    }
    for name, data in variants.items():
        tail = len(data) - len(data.rstrip(b"\0 \n")) if name.endswith("behind") else 0
        yield Dialect(f"{name} text.ply", data, tail=tail, trimesh=wrong.get(name, ""))
    faces = "".join(f"4 {' '.join(map(str, face))}\n" for face in _BOX_FACES)
    box = head.replace("vertex 6", "vertex 8").replace("face 8", "face 6") + _BOX + faces
    yield Dialect("box text.ply", box.encode(), "box")
    cloud = re.sub(r"element face 8\n.*\n", "", head) + POINTS
    yield Dialect("points text.ply", cloud.encode(), "cloud")
    yield Dialect("no faces text.ply", (head.replace("face 8", "face 0") + POINTS).encode(), "cloud")


def _ply_binary() -> Iterator[Dialect]:
    places = {"float": "f", "double": "d", "float32": "f", "float64": "d"}
    counts = {"uchar": "B", "uint8": "B", "int": "i", "ushort": "H"}
    corners = {"int": "i", "uint": "I", "short": "h", "uchar": "B", "int32": "i"}
    for (kind, order), (place, p), (count, n), (index, i) in itertools.product(
        (("binary_little_endian", "<"), ("binary_big_endian", ">")),
        places.items(),
        counts.items(),
        corners.items(),
    ):
        # A fifth of all mixtures: each kind of number still meets each other one.
        if (list(places).index(place) + 2 * list(counts).index(count) + list(corners).index(index)) % 5:
            continue
        head = _ply_head(kind, place=place, count=count, index=index)
        body = b"".join(struct.pack(f"{order}3{p}", *row) for row in VERTICES.tolist())
        body += b"".join(struct.pack(f"{order}{n}3{i}", 3, *row) for row in TRIANGLES.tolist())
        yield Dialect(f"{place} {count} {index} {kind[7]}.ply", head.encode() + body)
    plain = valid_files()["little.ply"].data
    start = plain.index(b"end_header\n") + len(b"end_header\n")
    yield Dialect("crlf header.ply", plain[:start].replace(b"\n", b"\r\n") + plain[start:])
    yield Dialect(
        "cr header.ply",
        plain[:start].replace(b"\n", b"\r") + plain[start:],
        trimesh="it wants line ends of Unix or Windows",
    )
    yield Dialect("mark.ply", b"\xef\xbb\xbf" + plain)
    yield Dialect(
        "latin header.ply",
        plain.replace(b"comment octahedron", "comment größer".encode("latin-1")),
        trimesh="it decodes only UTF-8",
    )
    yield Dialect("zeros behind.ply", plain + bytes(8), tail=8, trimesh=_SIZE)
    yield Dialect("newline behind.ply", plain + b"\n", tail=1, trimesh=_SIZE)
    upper = re.sub(rb"(?m)float ([xyz])$", lambda found: b"float " + found[1].upper(), plain[:start])
    yield Dialect("upper names.ply", upper + plain[start:], trimesh=_LOWER)
    yield Dialect("strips.ply", valid_files()["strips.ply"].data, trimesh="it passes over triangle strips")
    points = valid_files()["points.ply"].data
    yield Dialect("cloud.ply", points, "cloud", normals=True, colors=True)
    yield Dialect("big cloud.ply", _big_endian_cloud(), "cloud", normals=True, colors=True)


def _big_endian_cloud() -> bytes:
    plain = valid_files()["points.ply"].data
    start = plain.index(b"end_header\n") + len(b"end_header\n")
    record = np.dtype([("numbers", "<f4", 6), ("colours", "u1", 3)])
    table = np.frombuffer(plain[start:], dtype=record).astype(record.newbyteorder(">"))
    return plain[:start].replace(b"little", b"big") + table.tobytes()
