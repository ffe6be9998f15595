"""Files into arrays and Open3D geometry, without trusting them.

Open3D's own readers turn a broken file into an empty mesh, drop quads, read triangle strips as bare points, and are
native code that a hostile file may crash. Here files are parsed in Python, strictly (a truncated file is an error,
never part of a mesh), and in a separate process unless told otherwise.
"""

from __future__ import annotations

import atexit
import os
import warnings
from typing import Any

from fsh3d_o3d import _validation as check
from fsh3d_o3d._printable import printable
from fsh3d_o3d.errors import GeometryReadWarning
from fsh3d_o3d.files.formats import PARSERS, PARSERS_ABOVE, ReadFile, format_of
from fsh3d_o3d.files.object_storage import absolute
from fsh3d_o3d.files.parsing import read_file, require_readable
from fsh3d_o3d.files.reader_process import ReaderProcess
from fsh3d_o3d.geometry import GEOMETRY_KINDS, GeometryKind, MeshArrays, PointArrays, read_paths_with, to_open3d

READABLE_FORMATS: tuple[str, ...] = tuple(PARSERS)
"""Extensions that are read."""

_reader = ReaderProcess()
atexit.register(lambda: _reader.close())
os.register_at_fork(after_in_child=lambda: _reader.abandon())


def read_geometry_arrays(
    path: str | os.PathLike[str],
    *,
    isolated: bool = True,
    timeout: float = 120.0,
    memory_limit: int = 8 * 2**30,
) -> MeshArrays | PointArrays:
    """Read a mesh or a point cloud from a file.

    Meshes: ``.off .obj .ply .stl .glb .gltf`` (polygons, concave ones too, are cut into triangles, glTF scenes are
    placed as they stand while no animation plays, STL corners are welded where they are equal to the last bit; other
    duplicate vertices stay).
    Points: ``.xyz .xyzn .xyzrgb .pts .pcd``, and ``.ply .obj .off`` and glTF without faces, with normals and colours
    where the file has them. Exchange of CAD, printing, surveying, simulation and medicine: ``.3mf .step .iges .las .laz
    .e57 .vtk .vtp .vtu .dae .x3d .fbx .nii .nrrd .tif .npy``, some with an extra (``docs/formats.md``); and each of
    these packed as ``.gz``, or alone in a ``.zip``. Shapes: ``.npz`` as ``Shape.save`` writes it, decoded to a mesh.
    Buffers of a ``.gltf`` may lie in the same folder under a plain name, and voxels of a ``.nhdr``; nothing else is
    opened.

    Args:
        path: The file; its extension names the format. Also ``s3://bucket/name`` and the like, with the credentials
            and the endpoint of the environment.
        isolated: Parse in a separate process, so that whatever the file does to the parser, the caller lives.
        timeout: Seconds after which the separate process is stopped.
        memory_limit: Bytes that reading may take in the separate process.

    Raises:
        FileNotFoundError: There is no such file.
        GeometryReadError: The file cannot be read: one line that names the file and the reason.

    Warns:
        GeometryReadWarning: The file was read in spite of something.
    """
    found = read_geometry_file(path, isolated=isolated, timeout=timeout, memory_limit=memory_limit)
    for note in found.notes:
        warnings.warn(printable(f"{os.fsdecode(path)}: {note}"), GeometryReadWarning, stacklevel=2)
    return found.geometry


def read_geometry_file(
    path: str | os.PathLike[str],
    *,
    isolated: bool = True,
    timeout: float = 120.0,
    memory_limit: int = 8 * 2**30,
) -> ReadFile:
    """Read like ``read_geometry_arrays``, but return what is to be said of the file instead of warning."""
    name = absolute(path)
    timeout = check.seconds(timeout, "timeout")
    memory_limit = check.memory_limit(memory_limit, "memory_limit")
    require_readable(name)
    if not isolated or format_of(name) in PARSERS_ABOVE:  # which the reader, a small process, does not load
        return read_file(name)
    return _reader.read(name, timeout=timeout, memory_limit=memory_limit)


def read_geometry(path: str | os.PathLike[str], *, kind: GeometryKind = "legacy", isolated: bool = True) -> Any:
    """Read a file as an Open3D ``TriangleMesh`` or ``PointCloud``, legacy or tensor as ``kind`` says.

    See ``read_geometry_arrays`` for formats and errors.

    Example:
        >>> fsh.read_geometry("samples/gem.stl")
        TriangleMesh with 49 points and 94 triangles.
        >>> cloud = fsh.read_geometry("samples/bennu_cloud.ply", kind="tensor")
        >>> cloud.point.positions.shape
        SizeVector[6000, 3]
    """
    check.choice(kind, "kind", GEOMETRY_KINDS)
    return to_open3d(read_geometry_arrays(path, isolated=isolated), kind=kind)


read_paths_with(read_geometry_arrays)
