"""Point clouds as programs write them: .xyz and its kin, .pts and .pcd."""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Iterator

import numpy as np

from tests.files.dialects import NOT_COUNTED, POINTS, Dialect, encodings, line_ends, rows, spellings
from tests.files.mutations import COLORS, NORMALS, VERTICES, lzf_compress, valid_files

_NORMALS = rows(np.hstack([VERTICES, NORMALS]), "%r %r %r %.9f %.9f %.9f")
_COLORS = rows(np.hstack([VERTICES, COLORS]), "%r %r %r %d %d %d")
_FLOAT_COLORS = rows(np.hstack([VERTICES, COLORS / 255]), "%r %r %r %.9f %.9f %.9f")
_SCAN = rows(np.hstack([VERTICES, COLORS]), "%r %r %r -1023 %d %d %d")
_BLANKS_ONLY = "it wants numbers between blanks from the first line on"
_READ_BY_TRIMESH = {
    "lf",
    "crlf",
    "utf16le",
    "utf16be",
    "utf32",
    "tab",
    "blanks",
    "comma blank",
    "six",
    "signed",
    "exponent",
}
_READ_BY_TRIMESH |= {
    "capital",
    "long",
    "short",
    "blank lines",
    "indented",
    "no last line end",
    "intensity",
    "many columns",
}
_SEPARATORS = {"comma": ",", "comma blank": ", ", "semicolon": ";", "tab": "\t", "blanks": "   "}


def cloud_dialects() -> Iterator[Dialect]:
    """Yield clouds of the octahedron's vertices."""
    yield from _xyz()
    yield from _named_columns()
    yield from _kin()
    yield from _pts()
    yield from _pcd()


def _xyz() -> Iterator[Dialect]:
    variants = {
        **line_ends(POINTS.encode()),
        **encodings(POINTS.encode()),
        **{name: text.encode() for name, text in spellings(POINTS).items()},
        **{name: POINTS.replace(" ", mark).encode() for name, mark in _SEPARATORS.items()},
        "comma behind": POINTS.replace(" ", ",").replace("\n", ",\n").encode(),
        "decimal commas": POINTS.replace(" ", ";").replace(".", ",").encode(),
        "comment": b"# exported by a program\n" + POINTS.encode(),
        "slashes": b"// exported by a program\n" + POINTS.encode(),
        "percent": b"% exported by a program\n" + POINTS.encode(),
        "latin comment": "# größer\n".encode("latin-1") + POINTS.encode(),
        "comments behind": POINTS.replace("\n", " # a point\n").encode(),
        "blank lines": POINTS.replace("\n", "\n\n").encode(),
        "indented": re.sub(r"(?m)^", "   ", POINTS).encode(),
        "no last line end": POINTS.rstrip().encode(),
        "zeros behind": POINTS.encode() + bytes(100),
        "intensity": POINTS.replace("\n", " 0.5\n").encode(),
        "many columns": POINTS.replace("\n", " 1 2 3 4 5 6\n").encode(),
    }
    for name, data in variants.items():
        trimesh = "" if name in _READ_BY_TRIMESH else _BLANKS_ONLY
        yield Dialect(f"{name}.xyz", data, "cloud", cut=NOT_COUNTED, trimesh=trimesh)
    for name, mark in {"blank": " ", **_SEPARATORS}.items():
        text = "6\n" + POINTS.replace(" ", mark)
        yield Dialect(f"counted {name}.xyz", text.encode(), "cloud", trimesh=_BLANKS_ONLY)
    yield Dialect("counted names.xyz", f"//X Y Z\n6\n{POINTS}".encode(), "cloud", trimesh=_BLANKS_ONLY)
    yield Dialect("unit normals.xyz", _NORMALS.encode(), "cloud", normals=True, cut=NOT_COUNTED)
    text = f"nan nan nan\n{POINTS}inf 0 0\n"
    yield Dialect("nan.xyz", text.encode(), "cloud", cut=NOT_COUNTED, trimesh="it keeps what is not finite")


def _named_columns() -> Iterator[Dialect]:
    heads = {
        "plain": "x y z r g b",
        "capital": "X Y Z R G B",
        "slashes": "//X Y Z R G B",
        "hash": "# x y z r g b",
        "quoted": '"x" "y" "z" "red" "green" "blue"',
        "words": "X Y Z Red Green Blue",
    }
    for (name, head), (between, mark) in itertools.product(heads.items(), {"blank": " ", **_SEPARATORS}.items()):
        text = f"{head}\n{_COLORS}".replace(" ", mark)
        yield Dialect(
            f"{name} {between}.xyz", text.encode(), "cloud", colors=True, cut=NOT_COUNTED, trimesh=_BLANKS_ONLY
        )
    turned = rows(np.hstack([NORMALS, COLORS, VERTICES[:, ::-1]]), "%.9f %.9f %.9f %d %d %d %r %r %r")
    text = f"nx ny nz r g b z y x\n{turned}"
    yield Dialect(
        "turned.xyz", text.encode(), "cloud", normals=True, colors=True, cut=NOT_COUNTED, trimesh=_BLANKS_ONLY
    )
    text = f"X [m];Y [m];Z [m];Nx;Ny;Nz\n{_NORMALS.replace(' ', ';')}"
    yield Dialect("units.xyz", text.encode(), "cloud", normals=True, cut=NOT_COUNTED, trimesh=_BLANKS_ONLY)
    text = f"//X Y Z Rf Gf Bf\n{_FLOAT_COLORS}"
    yield Dialect("float colours.xyz", text.encode(), "cloud", colors=True, cut=NOT_COUNTED, trimesh=_BLANKS_ONLY)
    text = "x,y,z,intensity,label\n" + POINTS.replace(" ", ",").replace("\n", ",3,7\n")
    yield Dialect("other columns.xyz", text.encode(), "cloud", cut=NOT_COUNTED, trimesh=_BLANKS_ONLY)


def _kin() -> Iterator[Dialect]:
    for ending, text, given in ((".xyzn", _NORMALS, "normals"), (".xyzrgb", _COLORS, "colors")):
        variants = {
            **line_ends(text.encode()),
            "mark": b"\xef\xbb\xbf" + text.encode(),
            "comma": text.replace(" ", ",").encode(),
            "semicolon": text.replace(" ", ";").encode(),
            "comment": b"# by hand\n" + text.encode(),
            "alpha": text.replace("\n", " 255\n").encode(),
        }
        for name, data in variants.items():
            yield Dialect(name + ending, data, "cloud", cut=NOT_COUNTED, **{given: True})
        yield Dialect(f"counted{ending}", b"6\n" + text.encode(), "cloud", **{given: True})
    yield Dialect("floats.xyzrgb", _FLOAT_COLORS.encode(), "cloud", colors=True, cut=NOT_COUNTED)


def _pts() -> Iterator[Dialect]:
    scans = "".join(f"2\n{two}" for two in re.findall(r"(?:.*\n){2}", _SCAN))
    uneven = "".join(f"{n}\n{''.join(_SCAN.splitlines(True)[a : a + n])}" for a, n in ((0, 1), (1, 3), (4, 2)))
    variants = {
        **{f"ends {name}": data for name, data in line_ends(f"6\n{_SCAN}".encode()).items()},
        **encodings(f"6\n{_SCAN}".encode()),
        **{name: f"6\n{_SCAN}".replace(" ", mark).encode() for name, mark in _SEPARATORS.items()},
        "no intensity": f"6\n{_COLORS}".encode(),
        "scans": scans.encode(),
        "uneven scans": uneven.encode(),
        "blanks": f"6   \n\n{_SCAN}".encode(),
        "comment": f"# a scan\n6\n{_SCAN}".encode(),
    }
    for name, data in variants.items():
        yield Dialect(f"{name}.pts", data, "cloud", colors=True)
    yield Dialect("points.pts", f"6\n{POINTS}".encode(), "cloud")
    yield Dialect("intensity.pts", b"6\n" + POINTS.replace("\n", " -99\n").encode(), "cloud")
    yield Dialect("uncounted.pts", _SCAN.encode(), "cloud", colors=True, cut=NOT_COUNTED)
    yield Dialect("uncounted points.pts", POINTS.encode(), "cloud", cut=NOT_COUNTED)


def _pcd() -> Iterator[Dialect]:
    text = valid_files()["text.pcd"].data
    head = text[: text.index(b"DATA")]
    packed = (COLORS @ np.array([1 << 16, 1 << 8, 1])).astype("<u4")
    record = [
        struct.pack("<6fI", *row, color)
        for row, color in zip(np.hstack([VERTICES, NORMALS]).tolist(), packed.tolist(), strict=True)
    ]
    fields = np.hstack([VERTICES, NORMALS]).T.astype("<f4").tobytes() + packed.tobytes()
    squeezed = lzf_compress(fields)
    bodies = {
        "ascii": text[text.index(b"ascii\n") + 6 :],
        "binary": b"".join(record),
        "binary_compressed": struct.pack("<II", len(squeezed), len(fields)) + squeezed,
    }
    heads = {
        "plain": head,
        "crlf": head.replace(b"\n", b"\r\n"),
        "pointless": head.replace(b"POINTS 6\n", b""),
        "sizeless": head.replace(b"WIDTH 6\nHEIGHT 1\n", b""),
        "widthless": head.replace(b"WIDTH 6\n", b""),
        "heightless": head.replace(b"HEIGHT 1\n", b""),
        "width alone": head.replace(b"HEIGHT 1\n", b"").replace(b"POINTS 6\n", b""),
        "grid": head.replace(b"WIDTH 6\nHEIGHT 1\n", b"WIDTH 3\nHEIGHT 2\n"),
        "turned": head.replace(b"WIDTH 6\nHEIGHT 1\n", b"HEIGHT 1\nWIDTH 6\n"),
        "countless": head.replace(b"COUNT 1 1 1 1 1 1 1\n", b""),
        "versionless": head.replace(b"VERSION 0.7\n", b"").replace(b"VIEWPOINT 0 0 0 1 0 0 0\n", b""),
        "old version": head.replace(b"VERSION 0.7", b"VERSION .5"),
        "columns": head.replace(b"FIELDS", b"COLUMNS"),
        "upper": head.replace(b"x y z normal_x normal_y normal_z rgb", b"X Y Z NORMAL_X NORMAL_Y NORMAL_Z RGB"),
        "short normals": head.replace(b"normal_", b"n"),
        "rgba": head.replace(b"rgb", b"rgba"),
        "lower": head.lower(),
        "comments": head.replace(b"FIELDS", b"# of a scanner\nFIELDS").replace(b"HEIGHT 1", b"HEIGHT 1 # a row"),
        "blanks": re.sub(rb" ", b"  \t", head).replace(b"\n", b"  \n"),
        "latin": "# größer\n".encode("latin-1") + head,
    }
    for (name, start), (kind, body) in itertools.product(heads.items(), bodies.items()):
        yield Dialect(
            f"{name} {kind}.pcd", start + b"DATA " + kind.encode() + b"\n" + body, "cloud", normals=True, colors=True
        )
    whole = head + b"DATA ascii\n" + bodies["ascii"]
    for name, data in {**encodings(whole), "cr": line_ends(whole)["cr"]}.items():
        yield Dialect(f"{name}.pcd", data, "cloud", normals=True, colors=True)
    for kind, tail in (
        ("binary", b"\n"),
        ("binary", b"the end"),
        ("binary", bytes(900)),
        ("binary_compressed", bytes(900)),
    ):
        data = head + b"DATA " + kind.encode() + b"\n" + bodies[kind] + tail
        yield Dialect(f"{len(tail)} behind {kind}.pcd", data, "cloud", normals=True, colors=True, tail=len(tail))
