"""From one file to one row of an index, in whatever process or machine this is called."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import resource
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors import ShapeSignature, SHDOption, compute_signature
from fsh3d_o3d.errors import GeometryError
from fsh3d_o3d.files import file_content, format_of, is_uri, list_objects, object_states, parse_content
from fsh3d_o3d.geometry import EdgeTable, MeshArrays, PointArrays, weld
from fsh3d_o3d.index.codec import ALIGNED_DEGREES

Geometry = MeshArrays | PointArrays
Thumbnailer = Callable[[Geometry], bytes]
"""Makes a PNG of a geometry. Must pickle: it travels to the worker processes."""


@value
class FileState:
    """What tells, without reading it, that a file may have changed."""

    size: int
    """Bytes; of a ``.gltf`` with those of the buffers in its folder."""
    mtime: int
    """Time of the last change, in nanoseconds."""

    @classmethod
    def of(cls, path: str) -> FileState:
        """Return a file's, or an object's in storage; of a ``.gltf`` with the buffers in its folder.

        Raises:
            OSError: There is none.
        """
        found = cls.of_all([path])[path]
        if isinstance(found, FileState):
            return found
        if is_uri(path):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
        os.stat(path)  # noqa: PTH116 - raises what was found to be wrong
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)  # and is there again

    @classmethod
    def of_all(cls, paths: Iterable[str]) -> dict[str, FileState | str]:
        """Return each path's, or why there is none; objects are not asked for one by one.

        Raises:
            OSError: A storage does not answer, refuses, or has no such bucket.
        """
        states: dict[str, FileState | str] = dict.fromkeys(paths, os.strerror(errno.ENOENT))
        for path in states:
            if not is_uri(path):
                try:
                    about = os.stat(path)  # noqa: PTH116 - pathlib has nothing for names that are not UTF-8
                    states[path] = cls(about.st_size, about.st_mtime_ns)
                except OSError as error:
                    states[path] = error.strerror or str(error)
        found = object_states(path for path in states if is_uri(path))
        states |= {path: cls(one.size, one.mtime) for path, one in found.items()}
        buffers: dict[str, FileState] = {}
        for path, state in states.items():
            if isinstance(state, FileState) and has_buffers(path):
                folder = os.path.dirname(path)  # noqa: PTH120 - any bytes
                if folder not in buffers:
                    buffers[folder] = cls._of_buffers(folder)
                beside = buffers[folder]
                states[path] = cls(state.size + beside.size, max(state.mtime, beside.mtime))
        return states

    @classmethod
    def _of_buffers(cls, folder: str) -> FileState:
        """Of all buffers in a folder together: whose they are stands in files that are not read for this."""
        if is_uri(folder):
            found = [(one.size, one.mtime) for one in list_objects(folder, recursive=False) if _is_buffer(one.uri)]
        else:
            found = []
            with contextlib.suppress(OSError), os.scandir(folder) as entries:
                for entry in entries:
                    if _is_buffer(entry.name):
                        about = entry.stat()
                        found.append((about.st_size, about.st_mtime_ns))
        return cls(sum(size for size, _ in found), max((changed for _, changed in found), default=0))


def has_buffers(path: str) -> bool:
    """Return whether a file may take a part of its content from other files beside it."""
    return path.lower().endswith(".gltf")


def _is_buffer(name: str) -> bool:
    return name.lower().endswith(".bin")


@value
class Described:
    """What was found in a file."""

    state: FileState
    """The file's, before and after it was read."""
    content: bytes
    """SHA-256 of its bytes; where it needs others beside it, of the SHA-256 of all these files."""
    signature: ShapeSignature | None
    """Its descriptor; None where a file of this content and format is in the index already."""
    vertices: int = 0
    """Vertices or points."""
    triangles: int = 0
    """Triangles; 0 for a cloud."""
    watertight: bool = False
    """Whether every edge belongs to exactly two triangles once equal vertices are one."""
    thumbnail: bytes = b""
    """A PNG, or nothing."""


@value
class DescribeFile:
    """Reads a file, describes it, draws it: the function that is mapped over a library."""

    option: SHDOption
    """What is computed."""
    known: frozenset[bytes] = frozenset()
    """``identity`` of the files that need not be described again."""
    thumbnail: Thumbnailer | None = None
    """Draws the thumbnail; None: there is none."""
    memory_limit: int = 8 * 2**30
    """Bytes of address space that one file may take."""

    def __call__(self, path: str) -> Described:
        """Return what is in the file.

        Raises:
            OSError, GeometryError, MemoryError: It cannot be read or described, or changed meanwhile.
        """
        state = FileState.of(path)
        with _limited(self.memory_limit):
            data = file_content(path)
            content = hashlib.sha256(data).digest()
            if not has_buffers(path) and identity(path, content) in self.known:
                return Described(state, content, None)
            # Not in yet another process: this one is the one that may die.
            found = parse_content(path, data)
            geometry = found.geometry
            if found.used:
                parts = (hashlib.sha256(part).digest() for part in (data, *found.used))
                content = hashlib.sha256(b"".join(parts)).digest()
            del data, found
            if has_buffers(path) and identity(path, content) in self.known:
                return self._unchanged(path, Described(state, content, None))
            signature = describe(geometry, self.option)
            mesh = geometry if isinstance(geometry, MeshArrays) else None
            described = Described(
                state=state,
                content=content,
                signature=signature,
                vertices=len(geometry.vertices if isinstance(geometry, MeshArrays) else geometry.points),
                triangles=0 if mesh is None else len(mesh.triangles),
                watertight=mesh is not None and _watertight(mesh),
                thumbnail=b"" if self.thumbnail is None else self.thumbnail(geometry),
            )
        return self._unchanged(path, described)

    def _unchanged(self, path: str, described: Described) -> Described:
        if FileState.of(path) != described.state:
            raise GeometryError("changed while it was read")
        return described


def describe(geometry: Geometry, option: SHDOption) -> ShapeSignature:
    """Return the signature that an index keeps of a geometry.

    Raises:
        GeometryError: It cannot be described.
    """
    signature = compute_signature(geometry, option, bandwidth=min(ALIGNED_DEGREES, option.bandwidth))
    numbers = (signature.feature, signature.coefficients, signature.centroid, np.array(signature.rms_radius))
    if not all(np.isfinite(values).all() for values in numbers):
        raise GeometryError("its descriptor is not finite")
    return signature


def identity(path: str, content: bytes) -> bytes:
    """Return what two files have in common that hold the same geometry: content, and how it is read."""
    return content + os.fsencode(format_of(path))


def frame_numbers(signature: ShapeSignature) -> Float64Array:
    """Return centroid, RMS radius and principal axes as one vector (13,)."""
    return np.concatenate((signature.centroid, [signature.rms_radius], signature.axes.ravel()))


def similarity(own: NDArray[np.float64], other: NDArray[np.float64], rotation: Float64Array) -> Float64Array:
    """Return the (4, 4) map of ``other``'s geometry onto ``own``'s; frames (13,), rotation between principal axes."""
    turn = own[4:].reshape(3, 3).T @ rotation @ other[4:].reshape(3, 3)
    result = np.eye(4)
    result[:3, :3] = own[3] / other[3] * turn
    result[:3, 3] = own[:3] - result[:3, :3] @ other[:3]
    return result


def _watertight(mesh: MeshArrays) -> bool:
    try:
        return bool((EdgeTable(weld(mesh).triangles).faces == 2).all())
    except GeometryError:  # nothing but degenerate triangles
        return False


@contextlib.contextmanager
def _limited(extra: int) -> Iterator[None]:
    """A block that may take so many bytes of address space more than there are in use now."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a device, not a path
        limit = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE") + extra
    if before[1] != resource.RLIM_INFINITY:
        limit = min(limit, before[1])
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
