"""Libraries and indices on object storage: a server of the S3 protocol on this machine, which only the tests need."""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from moto.server import ThreadedMotoServer
from pyarrow.fs import S3FileSystem

import fsh3d_o3d as fsh
from fsh3d_o3d.cli import main
from fsh3d_o3d.files import object_storage as storage
from fsh3d_o3d.files.reading import read_geometry_arrays, read_geometry_file
from fsh3d_o3d.index.extraction import FileState
from fsh3d_o3d.index.library_scan import library_files
from fsh3d_o3d.index.shape_index import ShapeIndex, ShapeIndexError
from tests.files.mutations import gltf_tree
from tests.index.index_cases import QUICK, fill_slowly, write_library

NASTY = "parts/deep er/<b>'quo\"té'</b>.off"


@pytest.fixture(scope="module")
def server():
    """An S3 server, and the environment in which everything talks to it."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    process = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    process.start()
    host, port = process.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ACCESS_KEY_ID", "key")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_EC2_METADATA_DISABLED", "true")
        for name in ("AWS_ENDPOINT_URL_S3", "AWS_REGION", "AWS_DEFAULT_REGION", "AWS_SESSION_TOKEN"):
            patch.delenv(name, raising=False)
        yield S3FileSystem(
            access_key="key",
            secret_key="secret",
            region="us-east-1",
            scheme="http",
            endpoint_override=f"{host}:{port}",
            allow_bucket_creation=True,
            allow_bucket_deletion=True,
        )
    process.stop()


@pytest.fixture
def bucket(server):
    """The name of an empty bucket."""
    server.create_dir("library")
    yield "library"
    server.delete_dir("library")


@pytest.fixture
def upload(server, bucket):
    """A function that stores a file under a key."""

    def store(path: str | Path, key: str) -> str:
        with server.open_output_stream(f"{bucket}/{key}") as stream:
            stream.write(Path(path).read_bytes())
        return f"s3://{bucket}/{key}"

    return store


@pytest.fixture
def blobs(tmp_path) -> list[str]:
    return write_library(tmp_path / "local", range(4))


def distances(index: ShapeIndex, path: str) -> list[tuple[str, float]]:
    return [(Path(hit.path).name, hit.distance) for hit in index.query(path)]


def test_library_and_index_on_storage(upload, blobs, tmp_path, capsys):
    uris = [upload(path, f"parts/{Path(path).name}") for path in blobs[:3]]
    uris.append(upload(blobs[3], NASTY))
    upload(blobs[0], "parts/notes.txt")
    upload(blobs[0], "elsewhere/blob0.off")
    target = "s3://library/parts/parts.fsh"
    index = ShapeIndex.open(target, create=True, option=QUICK)
    update = index.add_files(library_files("s3://library/parts", leave_out=target))
    assert (update.added, update.failed) == (4, ())
    local = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    assert local.add_files(blobs).added == 4
    again = ShapeIndex.open(target, option=QUICK)
    assert (again.path, len(again)) == (target, 4)
    for path, uri in zip(blobs, uris, strict=True):
        hits = again.query(uri)
        assert hits[0].path == uri
        np.testing.assert_array_equal([h.distance for h in hits], [h.distance for h in local.query(path)])
    capsys.readouterr()
    assert main(["query", target, blobs[0], "--json"]) == 2  # the quick option has no name
    assert "same option" in capsys.readouterr().err


@pytest.mark.parametrize("isolated", [True, False])
def test_buffer_beside_a_gltf_file(isolated, server, bucket, tmp_path):
    tree, binary = gltf_tree()
    model = tmp_path / "model.gltf"
    model.write_text(json.dumps({**tree, "buffers": [{"byteLength": len(binary), "uri": "my%20part.bin"}]}))
    for key, content in (("parts/model.gltf", model.read_bytes()), ("parts/my part.bin", binary)):
        with server.open_output_stream(f"{bucket}/{key}") as stream:
            stream.write(content)
    assert len(read_geometry_arrays("s3://library/parts/model.gltf", isolated=isolated).triangles) == 8
    server.delete_file("library/parts/my part.bin")
    with pytest.raises(fsh.GeometryReadError, match=r"needs the file 'my part.bin' beside it: No such file"):
        read_geometry_arrays("s3://library/parts/model.gltf", isolated=isolated)


def test_only_what_is_new_is_read(upload, server, blobs, monkeypatch):
    uris = [upload(path, Path(path).name) for path in blobs]
    index = ShapeIndex.open("s3://library/index", create=True, option=QUICK)
    assert index.add_files(uris[:3]).added == 3
    update = index.add_files(uris)
    assert (update.added, update.unchanged) == (1, 3)
    copied = upload(blobs[1], "copy.OFF")
    assert index.add_files([copied]).moved == 1
    upload(blobs[0], "blob1.off")  # another content, and another size
    assert FileState.of(uris[1]).size == Path(blobs[0]).stat().st_size
    update = index.add_files([*uris, copied])
    assert (update.added, update.moved, update.unchanged) == (0, 1, 4)
    assert index.query(blobs[0], top=2, rerank=0)[1].feature_distance == 0
    server.delete_file("library/blob2.off")
    assert index.add_files(uris).failed[0].reason == os.strerror(2)
    assert index.prune("s3://library/nowhere") == 0
    assert index.prune("s3://library") == 1
    assert len(index) == 4
    server.delete_file("library/copy.OFF")
    assert index.prune() == 1


def test_local_index_of_a_stored_library(upload, blobs, tmp_path, capsys):
    for path in blobs:
        upload(path, f"parts/{Path(path).name}")
    (tmp_path / "empty.off").write_text("")
    upload(tmp_path / "empty.off", "parts/empty.off")
    index = str(tmp_path / "index")
    arguments = ["index", "s3://library/parts", index, "--option", "published", "--quiet", "--json"]
    assert main(arguments) == 1
    figures = json.loads(capsys.readouterr().out)
    assert (figures["added"], [entry["path"] for entry in figures["failed"]]) == (4, ["s3://library/parts/empty.off"])
    assert "empty" in figures["failed"][0]["reason"]
    page = tmp_path / "page.html"
    assert main(["query", index, "s3://library/parts", "--json", "--report", str(page)]) == 1
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [answer["query"] for answer in answers] == [answer["hits"][0]["path"] for answer in answers]
    assert len(answers) == 4
    assert "cannot be read now" not in page.read_text()
    assert main(["query", index, "s3://library/parts/blob2.off"]) == 0
    assert "1  0.0000  s3://library/parts/blob2.off" in capsys.readouterr().out


def test_default_option_by_command(upload, blobs, tmp_path, capsys):
    """Library and index stored, with no more than the commands of the documentation."""
    for path in blobs[:2]:
        upload(path, f"parts/{Path(path).name}")
    assert main(["index", "s3://library/parts/", "s3://library/parts.fsh/", "--quiet"]) == 0
    assert "s3://library/parts.fsh/: 2 models (2 added" in capsys.readouterr().out
    assert main(["index", "s3://library/parts", "s3://library/parts.fsh", "--quiet", "--prune"]) == 0
    assert "2 unchanged" in capsys.readouterr().out
    assert main(["query", "s3://library/parts.fsh", blobs[1], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["hits"][0]["path"] == "s3://library/parts/blob1.off"


def test_two_writers_at_once(upload, tmp_path):
    uris = [upload(path, Path(path).name) for path in write_library(tmp_path, range(10))]
    index = "s3://library/index"
    spawn = multiprocessing.get_context("spawn")
    writers = [spawn.Process(target=fill_slowly, args=(index, part)) for part in (uris[:8], uris[3:])]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0, 0]
    store = ShapeIndex.open(index, option=QUICK)._store
    assert sorted(store.columns(store.models, ["path"])["path"].to_pylist()) == sorted(map(os.fsencode, uris))


def test_ray_describes_what_is_stored(upload, blobs):
    uris = [upload(path, Path(path).name) for path in blobs]
    index = ShapeIndex.open("s3://library/index", create=True, option=QUICK)
    assert index.add_files(uris, workers=2, engine="ray").added == 4
    assert index.query(blobs[1])[0].path == uris[1]


def test_stored_geometry_is_read_like_a_file(upload, blobs, capsys):
    uri = upload(blobs[0], NASTY)
    for isolated in (True, False):
        found, expected = read_geometry_arrays(uri, isolated=isolated), read_geometry_arrays(blobs[0])
        np.testing.assert_array_equal(found.vertices, expected.vertices)
    assert len(fsh.read_geometry(uri).triangles) == len(expected.triangles)
    assert main(["info", uri]) == 0
    assert "star-shaped" in capsys.readouterr().out


def test_the_reader_follows_the_environment(upload, blobs):
    uri = upload(blobs[0], "a.off")
    assert len(read_geometry_arrays(blobs[0]).triangles) > 0  # there is a reader now, whatever it started with
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
        with pytest.raises(fsh.GeometryReadError, match="cannot be reached"):
            read_geometry_arrays(uri)
    assert len(read_geometry_arrays(uri).triangles) > 0


def test_changed_while_it_is_read(upload, blobs, monkeypatch):
    from fsh3d_o3d.index import extraction as extraction

    uri = upload(blobs[0], "a.off")
    describe = extraction.DescribeFile(QUICK)
    assert describe(uri).signature is not None

    def parse(path, data):
        upload(blobs[1], "a.off")
        return read_geometry_file(blobs[0])

    monkeypatch.setattr(extraction, "parse_content", parse)
    with pytest.raises(fsh.GeometryError, match="changed while"):
        describe(uri)


def test_nothing_there(bucket, upload, blobs, server, tmp_path, capsys):
    with pytest.raises(FileNotFoundError):
        ShapeIndex.open("s3://library/none")
    with pytest.raises(FileNotFoundError, match="bucket"):
        ShapeIndex.open("s3://no-such-bucket/index", create=True)
    upload(blobs[0], "folder/thesis.txt")
    with pytest.raises(ShapeIndexError, match="no index"):
        ShapeIndex.open("s3://library/folder")
    with pytest.raises(ShapeIndexError, match="something else"):
        ShapeIndex.open("s3://library/folder", create=True)
    with pytest.raises(FileNotFoundError):
        read_geometry_arrays("s3://library/none.off")
    with pytest.raises(FileNotFoundError, match="below this name"):
        list(library_files("s3://library/nowhere"))
    with pytest.raises(FileNotFoundError, match="bucket"):
        list(library_files("s3://no-such-bucket"))
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    with pytest.raises(FileNotFoundError, match="bucket"):
        index.prune("s3://no-such-bucket/parts")
    assert main(["index", "s3://no-such-bucket/parts", str(tmp_path / "new")]) == 2
    assert "s3://no-such-bucket/parts: No such bucket" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_bucket_that_is_gone_forgets_no_models(upload, blobs, server, tmp_path):
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    index.add_files([upload(path, Path(path).name) for path in blobs[:2]])
    server.delete_dir("library")
    with pytest.raises(FileNotFoundError, match="bucket"):
        index.prune()
    assert len(index) == 2
    server.create_dir("library")
    assert index.prune() == 2


def test_storage_that_does_not_answer(tmp_path, monkeypatch, capsys, server):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(ConnectionError, match="cannot be reached"):
        list(library_files("s3://library"))
    with pytest.raises(ConnectionError, match="cannot be reached"):
        ShapeIndex.open("s3://library/index", create=True)
    assert main(["index", "s3://library", str(tmp_path / "index")]) == 2
    assert "s3://library: the storage cannot be reached" in capsys.readouterr().err
    monkeypatch.setenv("AWS_ENDPOINT_URL", "127.0.0.1:9")
    with pytest.raises(ValueError, match="http://"):
        list(library_files("s3://library"))


def test_a_stored_library_that_moves(upload, blobs, server, tmp_path):
    for path in blobs:
        upload(path, f"parts/{Path(path).name}")
    index = ShapeIndex.open("s3://library/parts/index", create=True, option=QUICK)
    where = {"leave_out": "s3://library/parts/index"}
    assert index.add_files(library_files("s3://library/parts", **where), library="s3://library/parts").added == 4
    assert index.summary().libraries == {"s3://library/parts": 4}
    assert "s3://library/parts/blob1.off" in index
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    index.add_files(library_files("s3://library/parts", **where), library="s3://library/parts/")
    for path in blobs:
        upload(path, f"moved/{Path(path).name}")
    server.delete_dir("library/parts")
    update = index.add_files(library_files("s3://library/moved"), library="s3://library/moved")
    assert [(move.old, move.new) for move in update.libraries] == [("s3://library/parts", "s3://library/moved")]
    assert (update.added, update.moved + update.unchanged) == (0, 4)
    assert list(index) == [f"s3://library/moved/{Path(path).name}" for path in blobs]
    # And onto a disk.
    server.delete_dir("library/moved")
    folder = Path(blobs[0]).parent
    assert len(index.add_files(blobs, library=folder).libraries) == 1
    assert list(index) == blobs


class Refusing(BaseHTTPRequestHandler):
    """A storage that denies access, whatever it is asked."""

    def do_GET(self):
        text = b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"
        self.send_response(403)
        self.send_header("Content-Type", "application/xml")
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    do_HEAD = do_GET  # noqa: N815 - the name of the base class

    def log_message(self, *_):
        pass


@pytest.mark.parametrize("count", [1, 5])  # asked for one by one, and by a list
def test_denied_access_is_no_absence(upload, blobs, tmp_path, monkeypatch, count):
    (tmp_path / "more").mkdir()
    uris = [upload(path, f"parts/{Path(path).name}") for path in write_library(tmp_path / "more", range(count))]
    index = ShapeIndex.open(tmp_path / "index", create=True, option=QUICK)
    assert index.add_files(uris).added == count
    server = ThreadingHTTPServer(("127.0.0.1", 0), Refusing)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
        for ask in (
            index.prune,
            lambda: index.prune("s3://library/parts"),
            lambda: list(library_files("s3://library")),
        ):
            with pytest.raises(PermissionError, match="denies access"):
                ask()
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert len(index) == count


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        (
            "AWS Error ACCESS_DENIED during ListObjectsV2 operation: Access Denied",
            PermissionError,
        ),
        ("Generic S3 error: Server returned non-2xx status code: 403 Forbidden", PermissionError),
        (
            "AWS Error NETWORK_CONNECTION during HeadObject: curlCode: 28, Timeout was reached",
            ConnectionError,
        ),
        ("Generic S3 error: HTTP error: error sending request", ConnectionError),
        ("AWS Error NO_SUCH_BUCKET during PutObject operation", FileNotFoundError),
    ],
)
def test_what_the_storage_says(message, kind):
    assert type(storage.storage_error("s3://b/k", message)) is kind


def test_other_messages_are_not_guessed():
    assert storage.storage_error("s3://b/k", "Checksum of page 3 does not match") is None


@pytest.mark.parametrize("name", ["ftp://host/file.off", "https://host/file.off", "S4://b/k", "s3://", "s3:///key"])
def test_names_that_are_refused(name, capsys):
    with pytest.raises(ValueError, match=r"not supported|bucket is missing"):
        read_geometry_arrays(name)
    assert main(["info", name]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_names():
    assert storage.absolute("S3://Bucket/a%20b/") == "s3://Bucket/a%20b"
    assert storage.absolute(os.fsencode("x/ü\udcff")) == os.path.abspath("x/ü\udcff")  # noqa: PTH100 - as it does
    with pytest.raises(ValueError, match="as text"):
        storage.absolute(Path("s3://bucket/key"))
    assert not storage.is_uri("C:/file") and not storage.is_uri("/a://b")


def test_states_are_asked_for_in_lists(upload, blobs, monkeypatch):
    uris = [upload(blobs[0], f"f{n}/x{k}.off") for n, count in enumerate((5, 1)) for k in range(count)]
    asked = []
    original = storage.list_objects
    monkeypatch.setattr(storage, "list_objects", lambda uri, **how: asked.append(uri) or original(uri, **how))
    states = FileState.of_all([*uris, "s3://library/f0/none.off", blobs[0], blobs[0] + "none"])
    assert asked == ["s3://library/f0"]
    size = Path(blobs[0]).stat().st_size
    assert [states[uri].size for uri in uris] == [size] * 6
    assert states[uris[0]] == FileState.of(uris[0])
    assert [states[name] for name in ("s3://library/f0/none.off", blobs[0] + "none")] == [os.strerror(2)] * 2
    assert states[blobs[0]] == FileState.of(blobs[0])
