"""Files packed as .gz and .zip are read as what they hold, within bounds, or refused in one line."""

from __future__ import annotations

import gzip
import io
import json
import struct
import warnings
import zipfile
import zlib

import pytest

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files import format_of, is_readable, read_geometry_file
from fsh3d_o3d.files.formats import inflate, zip_parts
from fsh3d_o3d.files.parsing import parse_content
from tests.files import mutations

FILES = mutations.valid_files()


def zipped(parts: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as file:
        for name, data in parts.items():
            file.writestr(name, data)
    return buffer.getvalue()


def refuse(name: str, data: bytes, reason: str) -> None:
    with pytest.raises(GeometryReadError, match=reason) as caught:
        parse_content(f"/{name}", data)
    assert str(caught.value).startswith(f"/{name}: ") and len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("isolated", [True, False])
def test_every_format_is_read_packed(name, isolated, tmp_path):
    plain = parse_content(f"/{name}", FILES[name].data).geometry
    (tmp_path / f"{name}.gz").write_bytes(gzip.compress(FILES[name].data))
    (tmp_path / "models.zip").write_bytes(zipped({"readme.txt": b"hello", f"folder/{name}": FILES[name].data}))
    for path in (tmp_path / f"{name}.gz", tmp_path / "models.zip"):
        assert read_geometry_file(path, isolated=isolated).geometry == plain


def test_names_tell_what_is_packed():
    formats = {
        "a.STL.GZ": ".stl.gz",
        "a.stl": ".stl",
        "a.tar.gz": ".gz",
        "a.gz": ".gz",
        "a.zip": ".zip",
        "a.zip.gz": ".gz",
        "a.ply.gz.gz": ".gz",
    }
    assert {name: format_of(name) for name in formats} == formats
    assert [name for name in formats if is_readable(name)] == ["a.STL.GZ", "a.stl", "a.zip"]


def test_members_of_gzip_are_joined_and_filling_is_passed_over():
    data = FILES["plain.off"].data
    packed = gzip.compress(data[:40]) + gzip.compress(data[40:]) + bytes(512)
    assert parse_content("/a.off.gz", packed).geometry == parse_content("/a.off", data).geometry


def test_a_zip_gives_what_lies_beside():
    tree, binary = mutations.gltf_tree()
    tree["buffers"] = [{"byteLength": len(binary), "uri": "shape.bin"}]
    text = json.dumps(tree).encode()
    whole = zipped({"model/a.gltf": text, "model/shape.bin": binary, "__MACOSX/model/._a.gltf": b"x", ".x.stl": b"x"})
    found = parse_content("/a.zip", whole)
    assert len(found.geometry.triangles) == 8 and found.used == (binary,)
    refuse("a.zip", zipped({"model/a.gltf": text, "shape.bin": binary}), "no part 'model/shape.bin'")


@pytest.mark.parametrize("name", ["a.off.gz", "a.zip"])
def test_every_truncation_and_every_flipped_bit_is_refused_or_harmless(name):
    data = FILES["plain.off"].data
    plain = parse_content("/a.off", data).geometry
    packed = gzip.compress(data, mtime=0) if name.endswith(".gz") else zipped({"a.off": data})
    for size in range(len(packed)):
        with pytest.raises(GeometryReadError):
            parse_content(f"/{name}", packed[:size])
    for bit in range(8 * len(packed)):
        flipped = bytearray(packed)
        flipped[bit // 8] ^= 1 << bit % 8
        try:
            found = parse_content(f"/{name}", bytes(flipped)).geometry
        except GeometryReadError as error:
            assert "cannot be parsed" not in str(error)
        else:
            assert found == plain  # a date, a name that nobody needs


def test_bombs_are_refused_before_they_unfold(monkeypatch):
    zeros = bytes(2**20)
    monkeypatch.setattr(inflate, "MOST_UNPACKED", 2**16)
    monkeypatch.setattr(zip_parts, "MOST_UNPACKED", 2**16)
    refuse("a.off.gz", gzip.compress(zeros), "grows to more than 65536 bytes")
    refuse("a.off.gz", gzip.compress(zeros[: 2**15]) * 3, "grows to more than")
    bomb = zipped({"a.off": zeros})
    refuse("a.zip", bomb, "'a.off' grows to more than 65536 bytes")
    # One that lies about its size: in the list at the end and before the content.
    short = bomb.replace(struct.pack("<I", len(zeros)), struct.pack("<I", 1000))
    refuse("a.zip", short, "truncated or damaged: 'a.off'")


def test_a_bomb_costs_the_reading_process_no_more_than_its_limit(tmp_path):
    engine = zlib.compressobj(9, zlib.DEFLATED, inflate.GZIP)
    packed = b"".join(engine.compress(bytes(2**22)) for _ in range(256)) + engine.flush()  # 1 GiB in 1 MiB
    (tmp_path / "a.stl.gz").write_bytes(packed)
    with pytest.raises(GeometryReadError, match="needs more memory than the reader is allowed"):
        read_geometry_file(tmp_path / "a.stl.gz", memory_limit=2**28)


def test_encrypted_and_strangely_packed_parts_are_named():
    data = bytearray(zipped({"a.off": FILES["plain.off"].data}))
    for mark, place in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + place] |= 1
    refuse("a.zip", bytes(data), "'a.off' is encrypted: unpack it with its password")
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        refuse("a.zip", zipped({"a.off": FILES["plain.off"].data}, method), r"packed by method 1\d; only deflate")


@pytest.mark.parametrize("name", ["../a.off", "a/../../b.off", "/etc/a.off", "C:/a.off", "..\\a.off", ".."])
def test_names_that_lead_outside_are_refused(name):
    refuse("a.zip", zipped({"a.off": FILES["plain.off"].data, name: b"x"}), "which leads out of it")


def test_what_a_zip_holds_must_be_one_thing():
    off = FILES["plain.off"].data
    refuse("a.zip", zipped({"a.off": off, "b/c.stl": b"x"}), "2 files that could be meant: 'a.off', 'b/c.stl'; unpack")
    refuse("a.zip", zipped({"a.txt": b"x", "b.pdf": b"x"}), "none of its 2 files is of a format that is read: 'a.txt'")
    refuse("a.zip", zipped({"a.zip": zipped({"a.off": off})}), "it holds an archive, 'a.zip': unpack it first")
    refuse("a.zip", zipped({"a.off.gz": gzip.compress(off)}), "it holds an archive")
    refuse("a.zip", zipped({}), "it holds none")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zipfile warns the one who writes it
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as file:
            file.writestr("a.off", off)
            file.writestr("a.off", off[:-9])
    refuse("a.zip", buffer.getvalue(), "two parts are named 'a.off'")


def test_other_content_under_these_names_is_named():
    off = FILES["plain.off"].data
    refuse("a.off.gz", off, "the content looks like OFF|it is not packed")
    refuse("a.zip", off, "it is no ZIP file")
    refuse("a.off.gz", gzip.compress(b""), "the file is empty")
    refuse("a.off.gz", gzip.compress(FILES["text.ply"].data), "the content looks like PLY, not OFF")
    refuse("a.off.gz", gzip.compress(off) + b"more", "4 bytes behind the packed content")
    refuse("a.tar.gz", gzip.compress(off), "what is packed is not of a format that is read")
