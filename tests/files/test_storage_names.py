"""Names of object storage that hold secrets, and storage that accepts and never answers."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from pathlib import Path

import pytest

import fsh3d_o3d as fsh
from fsh3d_o3d._printable import printable
from fsh3d_o3d.cli import main
from fsh3d_o3d.files import object_storage as storage
from fsh3d_o3d.files.deadline import within
from fsh3d_o3d.index.library_scan import library_files

SECRETS = [
    "s3://KEY:HUSH@bucket/x.off",
    "s3://KEY:HU/SH@bucket/x.off",
    "S3://KEY:HUSH@bucket",
    "s3:/KEY:HUSH@bucket/x.off",  # as pathlib leaves it
    "s3://HUSH@bucket/x.off",
    "gs://KEY:HUSH@bucket/x.off",
    "abfss://box:HUSH@account.dfs.core.windows.net/x.off",
    "abfss://box@account.dfs.core.windows.net/x.off?sv=1&sig=HUSH",
    "s3://bucket/x.off?X-Amz-Signature=HUSH",
    "https://KEY:HUSH@host/x.off",
]
COMMANDS = [
    ["info", "{}"],
    ["reconstruct", "{}", "o.ply"],
    ["reconstruct", "i.ply", "{}"],
    ["describe", "{}", "-o", "f.npz"],
    ["align", "{}", "{}", "-o", "{}"],
    ["index", "{}", "i"],
    ["index", "l", "{}"],
    ["query", "{}", "{}"],
    ["evaluate", "--models", "{}", "--classification={}"],
    ["info", "x.off", "--{}"],
    ["{}"],
]


@pytest.mark.parametrize("name", SECRETS)
def test_secrets_are_refused_and_not_repeated(name, capfd):
    for command in COMMANDS:
        assert main([part.format(name) for part in command]) == 2
        out, err = capfd.readouterr()
        assert "HUSH" not in out + err and "HU/SH" not in out + err and "KEY:" not in err
        assert "environment variables" in err
    for ask in (fsh.read_geometry, fsh.ShapeIndex.open, lambda folder: list(library_files(folder))):
        with pytest.raises(ValueError, match="environment variables") as caught:
            ask(name)
        assert "HUSH" not in str(caught.value) and "HU/SH" not in str(caught.value)


def test_names_without_secrets():
    for name in ("abfss://box@account.dfs.core.windows.net/x.off", "s3://b/a:b@c.off", "gs://b/k?x=1", "s3://b/?.off"):
        assert storage.absolute(name) == name
    for name in ("a:b@c.off", "what?sig=1.off", "/mail:me@home/x.off"):
        assert storage.absolute(name).endswith(name)


def test_endpoints_with_secrets(monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "ftp://KEY:HUSH@host")
    with pytest.raises(ValueError, match="must begin with http") as caught:
        list(library_files("s3://bucket"))
    assert "HUSH" not in str(caught.value)
    assert printable("curl of http://me:HUSH@host/x failed") == "curl of http://…@host/x failed"


@pytest.fixture
def silent():
    """A server that accepts and never answers, and what connected to it."""
    with socket.create_server(("127.0.0.1", 0)) as server, contextlib.ExitStack() as connections:
        server.settimeout(0.1)
        over = threading.Event()

        def accept():
            while not over.is_set():
                with contextlib.suppress(TimeoutError):
                    connections.enter_context(server.accept()[0])

        thread = threading.Thread(target=accept)
        thread.start()
        yield server.getsockname()[1]
        over.set()
        thread.join()


def test_storage_that_accepts_and_never_answers(silent, monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("CLOUD_STORAGE_EMULATOR_ENDPOINT", f"http://127.0.0.1:{silent}")
    monkeypatch.setattr(storage, "_ANSWER_SECONDS", 0.5)
    for command in (
        ["index", "gs://bucket/parts", str(tmp_path / "i")],
        ["query", "gs://bucket/index", "gs://bucket/x"],
    ):
        assert main(command) == 2
        assert "the storage cannot be reached" in capsys.readouterr().err
    assert storage._answered == set()


def test_a_call_that_takes_too_long_is_left_behind():
    hold = threading.Event()
    with pytest.raises(TimeoutError, match="timed out"):
        within(0.05, lambda: hold.wait(60))
    hold.set()
    within(60, lambda: time.sleep(0))
    with pytest.raises(FileNotFoundError):
        within(60, lambda: Path("/none").stat())


@pytest.mark.parametrize(
    "message",
    ["Failed to get token from DefaultAzureCredential.", "Could not create a OAuth2 access token to authenticate"],
)
def test_missing_credentials_are_named(message):
    error = storage.storage_error("gs://b/k", message)
    assert isinstance(error, PermissionError) and "no credentials" in str(error)
