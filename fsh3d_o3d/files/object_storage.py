"""Files on object storage, named like ``s3://bucket/folder/file.stl``.

PyArrow lists and reads them. Credentials, region and endpoint are those of the environment, as for other tools:
``AWS_ACCESS_KEY_ID``, ``AWS_SECRET_ACCESS_KEY``, ``AWS_SESSION_TOKEN``, ``AWS_REGION``, ``AWS_ENDPOINT_URL``. No name
is ever decoded: what follows the scheme is the bucket and the key as they are.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any
from urllib.parse import urlsplit

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._printable import without_credentials
from fsh3d_o3d.files.deadline import within

_URI = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://(.*)", re.DOTALL)
SCHEMES = ("s3", "gs", "abfss")
"""That both PyArrow, for files, and Lance, for an index, know under this name."""
# User and password before the place, whose own name holds neither : nor @ (but an Azure container stands before an @);
# or a signature, token or key behind it.
_SECRET = re.compile(
    r"((?:s3|gs|abfss):/{1,2}|[A-Za-z][A-Za-z0-9+.-]*://)"
    r"([^/@:?]*:[^@]*@|(?<=s3://)[^/]*[@:]|(?<=gs://)[^/]*[@:]|"
    r"[^?]*\?(?:[^?]*&)?[^=&?]*(sig|signature|secret|token|password|access_?key|account_?key|credential)[^=&]*=)",
    re.IGNORECASE | re.DOTALL,
)
_CONNECT_SECONDS = 10.0  # to reach a storage, a choice; a connection takes well below one
_ANSWER_SECONDS = 30.0  # a choice, for the first answer of a storage whose own client may try for minutes
_LISTED_FROM = 4  # files of one folder, a choice: from here on one list of it replaces a question for each
# In messages of the AWS library behind PyArrow, and of the one behind Lance.
_NO_BUCKET = re.compile(r"NO_SUCH_BUCKET|NoSuchBucket")
_DENIED = re.compile(
    r"ACCESS_DENIED|INVALID_ACCESS_KEY|SIGNATURE_DOES_NOT_MATCH|AccessDenied|Forbidden|HTTP status 40[13]"
)
_NO_CREDENTIALS = re.compile(r"OAuth2 access token|DefaultAzureCredential|AuthenticationException")
_UNREACHABLE = re.compile(
    r"NETWORK_CONNECTION|[Cc]ould not (connect|resolve)|error sending request|HttpError|timed? ?out|ConnectError"
)


@dataclass(frozen=True)
class StoredObject:
    """What a list says of a file."""

    uri: str
    """Its name."""
    size: int
    """Bytes."""
    mtime: int
    """Time of the last change in nanoseconds, but in whole seconds, because not all answers tell more."""


def is_uri(name: str) -> bool:
    """Return whether a name is one of object storage rather than of a file system."""
    return _URI.fullmatch(name) is not None


def absolute(path: str | os.PathLike[str]) -> str:
    """Return a name that means the same from any working folder; no link is resolved.

    Bytes of a file's name that are not UTF-8 come as surrogates (``os.fsdecode``).

    Raises:
        ValueError: It is of a kind of storage that is not known, or no longer its name.
    """
    name = os.fsdecode(path)
    require_no_credentials(name)
    found = _URI.fullmatch(name)
    if found is None:
        if isinstance(path, os.PathLike) and name.startswith(tuple(f"{scheme}:/" for scheme in SCHEMES)):
            raise ValueError(f"{name}: give the name as text, because pathlib has taken away a slash")
        try:
            return os.path.abspath(name)  # noqa: PTH100 - pathlib has nothing for names that are not UTF-8
        except FileNotFoundError:
            raise FileNotFoundError(errno.ENOENT, "The working folder is gone: give a full name", name) from None
    scheme, rest = found.group(1).lower(), found.group(2).rstrip("/")
    if scheme not in SCHEMES:
        raise ValueError(f"{name}: {scheme}:// is not supported; {', '.join(f'{one}://' for one in SCHEMES)} are")
    if not rest or rest.startswith("/"):
        raise ValueError(f"{name}: the name of a bucket is missing after {scheme}://")
    return f"{scheme}://{rest}"


def require_no_credentials(name: str) -> None:
    """Refuse a name that holds a password or the like, which lists, tables and messages would show on.

    Raises:
        ValueError: It does; the message does not repeat it.
    """
    found = _SECRET.search(name)
    if found is not None:
        raise ValueError(
            f"a name of storage ({found.group(1).lower()}…) holds credentials: leave them out, and give them in "
            "environment variables such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
        )


def object_content(uri: str) -> bytes:
    """Return the bytes of a file.

    Raises:
        OSError: It is not there, or cannot be read.
    """
    files, path = _located(uri)
    with _storage_errors(uri), files.open_input_file(path) as stream:
        return bytes(stream.read())


def object_states(uris: Iterable[str]) -> dict[str, StoredObject]:
    """Return what is known of files without reading them; those that are not there are left out.

    Raises:
        OSError: The storage does not answer, refuses, or has no such bucket.
    """
    folders: dict[str, list[str]] = defaultdict(list)
    for uri in uris:
        folders[uri.rpartition("/")[0]].append(uri)
    found: dict[str, StoredObject] = {}
    for folder, names in folders.items():
        if len(names) >= _LISTED_FROM and not folder.endswith("/"):
            listed = {one.uri: one for one in list_objects(folder, recursive=False)}
            found |= {name: listed[name] for name in names if name in listed}
            continue
        files, _ = _located(folder)
        with _storage_errors(folder):
            answers = files.get_file_info([_located(name)[1] for name in names])
        there = {name: _stored(name, about) for name, about in zip(names, answers, strict=True) if about.is_file}
        if len(there) < len(names):
            require_bucket(folder)  # which is not told from a missing file
        found |= there
    return found


def list_objects(uri: str, *, recursive: bool) -> list[StoredObject]:
    """Return the files below a folder, by name; none where there is no such folder.

    Raises:
        OSError: The storage does not answer, refuses, or has no such bucket.
    """
    scheme = uri.partition("://")[0]
    return [_stored(f"{scheme}://{one.path}", one) for one in _listing(uri, recursive) if one.is_file]


def folder_names(uri: str) -> set[str]:
    """Return the names of files and folders in a folder; none where there is no such folder.

    Raises:
        OSError: The storage does not answer, refuses, or has no such bucket.
    """
    return {one.base_name for one in _listing(uri, recursive=False)}


def require_bucket(uri: str) -> None:
    """Find out whether the bucket of a name is there.

    Raises:
        OSError: It is not, or the storage does not answer.
    """
    fs = import_installed("pyarrow.fs")

    files, path = _located(uri)
    with _storage_errors(uri):
        bucket = files.get_file_info(path.partition("/")[0])
    if bucket.type == fs.FileType.NotFound:
        raise FileNotFoundError(errno.ENOENT, "No such bucket", uri)


def lance_options(uri: str) -> dict[str, str] | None:
    """Return what Lance is to be told of the storage beyond what it finds in the environment; None for a folder."""
    if not is_uri(uri):
        return None
    options = {"connect_timeout": f"{_CONNECT_SECONDS:g}s", "client_max_retries": "3"}
    endpoint, region = _endpoint(), _region()
    if uri.startswith("s3://"):
        if endpoint:
            options |= {"aws_endpoint": endpoint, "aws_region": region or "us-east-1"}
            options["allow_http"] = str(endpoint.startswith("http://")).lower()
        elif region:
            options["aws_region"] = region
    return options


def storage_error(uri: str, message: str) -> OSError | None:
    """Return the error that PyArrow's or Lance's message stands for; None where it tells of nothing known."""
    if _NO_BUCKET.search(message):
        return FileNotFoundError(errno.ENOENT, "No such bucket", uri)
    if _DENIED.search(message):
        return PermissionError(errno.EACCES, "the storage denies access", uri)
    if _NO_CREDENTIALS.search(message):
        return PermissionError(errno.EACCES, "the environment holds no credentials for the storage", uri)
    if _UNREACHABLE.search(message):
        return ConnectionError(errno.EHOSTUNREACH, "the storage cannot be reached", uri)
    return None


def _located(uri: str) -> tuple[Any, str]:
    """The file system of a name, and its path there."""
    scheme, _, path = uri.partition("://")
    if scheme == "s3":
        return _s3(_endpoint(), _region()), path
    fs = import_installed("pyarrow.fs")

    with _storage_errors(uri):
        if scheme == "gs":
            files = fs.GcsFileSystem(retry_time_limit=timedelta(seconds=_CONNECT_SECONDS))
        else:
            files, path = fs.FileSystem.from_uri(uri)
        bucket = path.partition("/")[0]
        if (scheme, bucket) not in _answered:
            # For a file, there or not: asked for a bucket without credentials, Azure's client ends the process.
            within(_ANSWER_SECONDS, lambda: files.get_file_info(f"{bucket}/-"))
            _answered.add((scheme, bucket))
    return files, path


_answered: set[tuple[str, str]] = set()


@functools.lru_cache(maxsize=4)
def _s3(endpoint: str | None, region: str | None) -> Any:
    fs = import_installed("pyarrow.fs")

    options: dict[str, Any] = {"connect_timeout": _CONNECT_SECONDS}
    if endpoint:
        parts = urlsplit(endpoint)
        options |= {"scheme": parts.scheme, "endpoint_override": parts.netloc + parts.path.rstrip("/")}
        region = region or "us-east-1"
    return fs.S3FileSystem(region=region, **options)


def _endpoint() -> str | None:
    endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or None
    if endpoint is not None and urlsplit(endpoint).scheme not in ("http", "https"):
        raise ValueError(f"AWS_ENDPOINT_URL must begin with http:// or https://, got {without_credentials(endpoint)!r}")
    return endpoint


def _region() -> str | None:
    return os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION") or None


def _listing(uri: str, recursive: bool) -> list[Any]:
    fs = import_installed("pyarrow.fs")

    files, path = _located(uri)
    with _storage_errors(uri):
        found = files.get_file_info(fs.FileSelector(path, allow_not_found=True, recursive=recursive))
    if not found:
        require_bucket(uri)
    return list(found)


def _stored(uri: str, about: Any) -> StoredObject:
    return StoredObject(uri, int(about.size), (about.mtime_ns or 0) // 10**9 * 10**9)


@contextlib.contextmanager
def _storage_errors(uri: str) -> Iterator[None]:
    """A block that asks the storage: what it says comes out as the ``OSError`` of a file system, in one line."""
    try:
        yield
    except FileNotFoundError:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), uri) from None
    except Exception as error:  # its clients raise of all kinds
        text = without_credentials(" ".join(str(error).split()))
        raise (storage_error(uri, text) or OSError(errno.EIO, text[:300], uri)) from None
