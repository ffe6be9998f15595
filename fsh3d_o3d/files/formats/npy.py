"""NPY: an array of NumPy, as a volume of voxels or as points."""

from __future__ import annotations

import io

import numpy as np

from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.optional import guarded
from fsh3d_o3d.files.formats.result import cloud_of
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.volumes import surfaces_of
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_POINTS = 3  # columns of an array of points


def parse_npy(source: Source) -> MeshArrays | PointArrays:
    """Return an (n, 3) array as a cloud, an (n, m, k) array as a volume: voxel [i, j, l] lies at x, y, z = i, j, l."""
    stream = io.BytesIO(source.data)
    with guarded("its header cannot be read"):
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    if dtype.hasobject or dtype.kind not in "biuf":
        raise GeometryReadError(f"it holds no real numbers but '{dtype}'")
    behind = len(source.data) - stream.tell()
    count = int(np.prod([float(length) for length in shape]))
    if behind != count * dtype.itemsize:
        size = " x ".join(map(str, shape))
        raise GeometryReadError(f"truncated or damaged: an array of {size} numbers needs other than {behind} bytes")
    array = np.frombuffer(source.data, dtype=dtype, count=count, offset=stream.tell())
    array = array.reshape(shape, order="F" if fortran else "C")
    if array.ndim == 2 and array.shape[1] == _POINTS:
        return cloud_of(source, array.astype(np.float64))
    return surfaces_of(source, array, np.eye(3, 4))
