"""STEP and IGES: flat faces exactly, round ones within the tolerance, and what is refused."""

from __future__ import annotations

import os
import re
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.parsing import parse_content
from fsh3d_o3d.geometry import EdgeTable
from tests.files.exchange import iges_bytes, step_bytes
from tests.files.mutations import TRIANGLES, VERTICES

OUTLINE = np.array([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3.0]])  # an L, concave
BRACKET = np.vstack([np.insert(OUTLINE, 2, height, axis=1) for height in (0, 2)])
FACES = [[5, 4, 3, 2, 1, 0], [6, 7, 8, 9, 10, 11], *([i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6))]
VOLUME = 12.0  # (4 + 2) · 2


def read(name: str, data: bytes):
    pytest.importorskip("cascadio", reason="cascadio is not installed: the extra of this format is absent")
    return parse_content(f"/{name}", data)


def volume(mesh) -> float:
    return float(np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6)


def ball(radius: float) -> bytes:
    """A solid whose only face is a sphere."""
    text = step_bytes(VERTICES, TRIANGLES.tolist()).decode()
    k = max(int(number) for number in re.findall(r"#(\d+)=", text))
    face = [
        f"CARTESIAN_POINT('',(0.,0.,{radius!r}))",
        f"VERTEX_POINT('',#{k + 1})",
        f"VERTEX_LOOP('',#{k + 2})",
        f"FACE_BOUND('',#{k + 3},.T.)",
        "CARTESIAN_POINT('',(0.,0.,0.))",
        f"AXIS2_PLACEMENT_3D('',#{k + 5},$,$)",
        f"SPHERICAL_SURFACE('',#{k + 6},{radius!r})",
        f"ADVANCED_FACE('',(#{k + 4}),#{k + 7},.T.)",
    ]
    text = re.sub(r"(CLOSED_SHELL\('',)\([^)]*\)", rf"\1(#{k + 8})", text)
    added = "".join(f"#{k + 1 + place}={line};\n" for place, line in enumerate(face))
    return text.replace("ENDSEC;\nEND-ISO", f"{added}ENDSEC;\nEND-ISO").encode()


@pytest.mark.parametrize(("name", "write"), [("a.step", step_bytes), ("a.igs", iges_bytes)])
def test_a_solid_with_a_concave_face_is_closed_and_exact(name, write):
    found = read(name, write(BRACKET, FACES))
    assert found.notes == ()
    assert len(found.geometry.vertices) == 12 and len(found.geometry.triangles) == 20
    assert (EdgeTable(found.geometry.triangles).faces == 2).all()
    assert volume(found.geometry) == pytest.approx(VOLUME, rel=1e-6)  # float32 on the way


@pytest.mark.parametrize("radius", [0.01, 1.0, 1000.0])
def test_round_faces_keep_the_tolerance_at_every_size(radius):
    mesh = read("a.step", ball(radius)).geometry
    lengths = np.linalg.norm(mesh.vertices, axis=1)
    np.testing.assert_allclose(lengths, radius, rtol=1e-5)
    assert -0.002 < volume(mesh) / (4 / 3 * np.pi * radius**3) - 1 < 0  # 0.15 % too little, as docs tell


def test_other_units_become_millimetres():
    metres = step_bytes(BRACKET, FACES).replace(b"SI_UNIT(.MILLI.,.METRE.)", b"SI_UNIT($,.METRE.)")
    assert read("a.stp", metres).geometry.vertices.max() == pytest.approx(4000, rel=1e-6)
    inches = iges_bytes(BRACKET, FACES).replace(b"1.,2,2HMM", b"1.,1,2HIN")
    assert read("a.iges", inches).geometry.vertices.max() == pytest.approx(101.6, rel=1e-6)


def test_faces_that_cannot_be_computed_are_counted():
    data = step_bytes(BRACKET, FACES)
    flat = data.replace(b"PLANE(", b"PLANEX(", 1)
    found = read("a.step", flat)
    assert len(found.geometry.triangles) < 20
    assert found.notes == ("1 of its 8 faces have no surface that can be computed; they are missing",)


def test_refused_with_the_reason():
    def refuse(name: str, data: bytes, reason: str) -> None:
        with pytest.raises(GeometryReadError, match=reason):
            read(name, data)

    step, iges = step_bytes(BRACKET, FACES), iges_bytes(BRACKET, FACES)
    refuse("a.step", step[:-20], "truncated: its last line")
    refuse("a.step", step.replace(b"#9=", b"#9999=", 1), "1 of its entities are named, but not there, such as #9$")
    refuse("a.step", b"ISO-10303-21;\nEND-ISO-10303-21;\n", "no surface that it can read")
    refuse("a.step", iges, "the content looks like|does not begin with")
    lines = iges.splitlines(keepends=True)
    refuse("a.igs", b"".join(lines[:-1]), "with a T in column 73, is missing")
    refuse("a.igs", b"".join(lines[:9] + lines[10:]), "section D has 113 lines|section D has .* tells otherwise")


def test_without_cascadio_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "cascadio", None)
    for name, data in (("a.step", step_bytes(BRACKET, FACES)), ("a.igs", iges_bytes(BRACKET, FACES))):
        with pytest.raises(GeometryReadError, match=r"STEP and IGES files need the package cascadio.*\[cad\]'$"):
            parse_content(f"/{name}", data)


def test_the_library_is_silent(capfd):
    with pytest.raises(GeometryReadError):
        read("a.step", b"ISO-10303-21;\nEND-ISO-10303-21;\n")
    assert capfd.readouterr() == ("", "")


def test_threads_leave_standard_output_as_it_was(capfd):
    data = step_bytes(BRACKET, FACES)
    read("a.step", data)
    with ThreadPoolExecutor(4) as pool:
        meshes = list(pool.map(lambda _: parse_content("/a.step", data).geometry, range(8)))
    os.write(1, b"seen")
    assert capfd.readouterr() == ("seen", "") and all(mesh == meshes[0] for mesh in meshes)
