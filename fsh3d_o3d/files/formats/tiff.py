"""TIFF stacks: pages of pictures, one a layer of voxels."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.inflate import MOST_UNPACKED
from fsh3d_o3d.files.formats.optional import guarded, optional_module
from fsh3d_o3d.files.formats.source import Source
from fsh3d_o3d.files.formats.volumes import surfaces_of
from fsh3d_o3d.geometry import MeshArrays, PointArrays

_MILLIMETRES = {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "micron": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
_UNIT_OF_TAG = {2: 25.4, 3: 10.0}  # millimetres in the units that resolutions of TIFF are in: inch, centimetre
_one_at_a_time = threading.Lock()
_DAMAGE = re.compile(r"invalid|corrupt|truncat|missing", re.IGNORECASE)
_OME_SIZE = re.compile(r'PhysicalSize([XYZ])="([^"]+)"')
_OME_UNIT = re.compile(r'PhysicalSize([XYZ])Unit="([^"]+)"')


def parse_tiff(source: Source) -> MeshArrays | PointArrays:
    """Return the surfaces of a stack: column, row and page of a voxel are x, y, z, in millimetres if it tells."""
    tifffile = optional_module("tifffile", extra="formats", what="TIFF files")
    with (
        guarded("it is no TIFF that can be read"),
        _complaints() as said,
        tifffile.TiffFile(io.BytesIO(source.data)) as file,
    ):
        if not file.series and said:
            raise GeometryReadError(f"truncated or damaged: {' '.join(said[0].split())[:160]}")
        if not file.series:
            raise GeometryReadError("it holds no pictures")
        series = file.series[0]
        if len(file.series) > 1:
            source.note(f"of {len(file.series)} series of pictures only the first was read")
        if "S" in series.axes:
            raise GeometryReadError("its pictures have colours: only labels or single values are read")
        size = float(np.prod([float(length) for length in series.shape])) * series.dtype.itemsize
        if size > MOST_UNPACKED:
            raise GeometryReadError(f"it grows to more than {MOST_UNPACKED} bytes when it is unpacked")
        stack = series.asarray()
        spacing = _spacing(source, file)
    if said:  # what it cannot read of a file, such as pages that are cut off, it leaves out
        raise GeometryReadError(f"truncated or damaged: {' '.join(said[0].split())[:160]}")
    if stack.ndim < 3:
        raise GeometryReadError(f"a picture of {' x '.join(map(str, stack.shape))}, no stack of them")
    placement = np.hstack([np.diag(spacing), np.zeros((3, 1))])
    return surfaces_of(source, np.transpose(stack), placement)


@contextlib.contextmanager
def _complaints() -> Iterator[list[str]]:
    """A block in which what tifffile logs of damage is kept, and nothing of it is shown."""
    logger = logging.getLogger("tifffile")
    said: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if _DAMAGE.search(record.getMessage()):
                said.append(record.getMessage())

    keep = Keep(logging.WARNING)
    with _one_at_a_time:  # else a thread would put back what another one had put in place
        before, logger.propagate = logger.propagate, False
        logger.addHandler(keep)
        try:
            yield said
        finally:
            logger.removeHandler(keep)
            logger.propagate = before


def _spacing(source: Source, file: Any) -> Float64Array:
    """Return the size (3,) of a voxel along x, y and z."""
    page = file.pages[0]
    if file.is_ome:
        sizes = dict(_OME_SIZE.findall(file.ome_metadata or ""))
        units = dict(_OME_UNIT.findall(file.ome_metadata or ""))
        if "X" in sizes and "Y" in sizes:
            sizes.setdefault("Z", sizes["X"])
            return np.array([float(sizes[axis]) * _MILLIMETRES.get(units.get(axis, "µm"), 1.0) for axis in "XYZ"])
    about = file.imagej_metadata or {}
    unit = str(about.get("unit", "")).replace("\\u00B5", "µ")
    scale = _MILLIMETRES.get(unit, _UNIT_OF_TAG.get(_tag(page, "ResolutionUnit"), 1.0) if not about else 1.0)
    steps = []
    for name in ("XResolution", "YResolution"):
        found = _tag(page, name)
        above, below = found if isinstance(found, tuple) else (1, 1)
        steps.append(below / above if above and below else 1.0)
    known = _tag(page, "ResolutionUnit") in _UNIT_OF_TAG or bool(about)
    across = np.array(steps) * scale if known else np.ones(2)
    if "spacing" in about:
        return np.array([*across, float(about["spacing"]) * scale])
    source.note("the distance of its pages is not given; they were taken to be as far apart as its columns")
    return np.array([*across, across[0]])


def _tag(page: Any, name: str) -> Any:
    tag = page.tags.get(name)
    return None if tag is None else tag.value
