"""Volumes of voxels into surfaces: one around each label, or the one where values cross a threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.assembly import Assembly
from fsh3d_o3d.files.formats.source import Source, counted
from fsh3d_o3d.geometry import MeshArrays, PointArrays

Voxels = NDArray[np.generic]

_MOST_VOXELS = 2**30  # a choice: marching through them takes minutes and 4 GB
_MOST_LABELS = 1000  # a choice: atlases of the brain have some hundred
_WIDEST_RANGE = 2**20  # between the largest and the smallest label, a choice: what can be counted by value
_LABELS_DIFFER = (
    0.5  # share of neighbouring voxels, neither empty, that differ: a tenth of labels, nearly all of images
)
_LEVELS = 1024  # of the histogram in which a threshold is looked for, a choice


def surfaces_of(
    source: Source,
    voxels: Voxels,
    placement: Float64Array,
    *,
    labels: bool = False,
    names: dict[int, str] | None = None,
) -> MeshArrays | PointArrays:
    """Return the surfaces of a volume (n, m, k), whose voxel (i, j, l) has its centre at ``placement`` · (i, j, l, 1).

    Whole numbers of which neighbours mostly agree are labels: each has a closed surface and is a part, 0 is the
    background. Others are values, cut where Otsu's threshold is. What reaches the end of the volume is closed there.

    Args:
        source: The file, for notes and parts.
        voxels: Their values.
        placement: (3, 4), from indices to coordinates.
        labels: The file says that they are labels.
        names: What labels are called, where the file tells.
    """
    voxels = _three_axes(voxels)
    if voxels.dtype.kind not in "biuf":
        raise GeometryReadError(f"its voxels are no numbers but '{voxels.dtype.name}'")
    if voxels.size > _MOST_VOXELS:
        raise GeometryReadError(f"it has {voxels.size} voxels, more than {_MOST_VOXELS}")
    if not (np.isfinite(placement).all() and np.linalg.det(placement[:, :3]) != 0):
        raise GeometryReadError("damaged: its voxels have no size")
    if voxels.dtype.kind == "f" and not np.isfinite(voxels).all():
        wrong = int(voxels.size - np.isfinite(voxels).sum())
        if wrong == voxels.size:
            raise GeometryReadError("none of its values is finite")
        source.note(f"{counted(wrong, 'voxel')} that are NaN or infinite were taken for the smallest value")
        voxels = np.where(np.isfinite(voxels), voxels, voxels[np.isfinite(voxels)].min())
    found = _labels(voxels, known=labels)
    assembly = Assembly(source)
    if found is None:
        level = _threshold(voxels)
        source.note(f"the surface is where its values reach {level:.6g}, chosen by Otsu's method")
        _add(assembly, f"values of {level:.6g} and more", voxels.astype(np.float32), level, placement, (0, 0, 0))
        return assembly.result()
    values, compact = found
    boxes = import_installed("scipy.ndimage").find_objects(compact)
    for number, box in enumerate(boxes, 1):
        if box is not None:
            inside = (compact[box] == number).astype(np.float32)
            corner = tuple(int(part.start) for part in box)
            name = (names or {}).get(int(values[number]), f"label {values[number]}")
            _add(assembly, name, inside, 0.5, placement, corner)
    return assembly.result()


def _three_axes(voxels: Voxels) -> Voxels:
    if voxels.size == 0:
        raise GeometryReadError("it has no voxels")
    sizes = " x ".join(map(str, voxels.shape))
    if voxels.ndim < 3:
        raise GeometryReadError(f"an array or picture of {sizes}, no volume")
    if any(length != 1 for length in voxels.shape[3:]):
        raise GeometryReadError(f"it holds several volumes ({sizes}): save one of them")
    return voxels.reshape(voxels.shape[:3])


def _labels(voxels: Voxels, *, known: bool) -> tuple[IntArray, NDArray[np.int32]] | None:
    """Return the labels, the background first, and for each voxel its place among them; None for other values."""
    if voxels.dtype.kind == "f":
        whole = voxels.astype(np.int64) if np.abs(voxels).max() < 2**53 else None
        if whole is None or not np.array_equal(whole, voxels):
            return None
        voxels = whole
    low, high = int(voxels.min()), int(voxels.max())
    if high == low:
        raise GeometryReadError(f"all its voxels are {low}: there is no surface")
    if high - low > _WIDEST_RANGE:
        return None
    shifted = (voxels.astype(np.int64) - low).astype(np.int32)
    values = np.flatnonzero(np.bincount(shifted.ravel(), minlength=high - low + 1)) + low
    if len(values) > _MOST_LABELS and not known:
        return None
    background = 0 if 0 in values else low
    if len(values) > 2 and not known and _differing(shifted + low, background) > _LABELS_DIFFER:
        return None
    others = values[values != background]
    places = np.zeros(high - low + 1, dtype=np.int32)
    places[others - low] = np.arange(1, len(others) + 1)
    return np.concatenate([[background], others]), places[shifted]


def _differing(voxels: Voxels, background: int) -> float:
    """Share of pairs of neighbours, neither of them background, that have other values."""
    differing = pairs = 0
    for axis in range(3):
        a, b = np.moveaxis(voxels, axis, 0)[:-1], np.moveaxis(voxels, axis, 0)[1:]
        both = (a != background) & (b != background)
        pairs += int(both.sum())
        differing += int((both & (a != b)).sum())
    return differing / pairs if pairs else 0.0


def _threshold(voxels: Voxels) -> float:
    """Otsu's: the value that splits the histogram into two classes whose means are furthest apart, weighted."""
    counts, edges = np.histogram(voxels, bins=_LEVELS)
    middles = (edges[:-1] + edges[1:]) / 2
    below = np.cumsum(counts)
    sums = np.cumsum(counts * middles)
    above = below[-1] - below
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = below * above * (sums / below - (sums[-1] - sums) / above) ** 2
    best = int(np.nanargmax(apart[:-1]))
    return float(edges[best + 1])


def _add(
    assembly: Assembly,
    name: str,
    values: NDArray[np.float32],
    level: float,
    placement: Float64Array,
    corner: tuple[int, ...],
) -> None:
    """Add the closed surface around where values reach a level; ``corner`` is the index of the first voxel."""
    marching_cubes = import_installed("skimage.measure").marching_cubes
    outside = min(float(values.min()), 2 * level - float(values.max()))
    vertices, triangles = marching_cubes(np.pad(values, 1, constant_values=outside), level)[:2]
    places = (vertices.astype(np.float64) - 1 + corner) @ placement[:, :3].T + placement[:, 3]
    triangles = triangles.astype(np.int64)
    # Seen from the middle of the surface, so that what is far away does not drown the sign.
    inner = places - places.mean(axis=0)
    if np.linalg.det(inner[triangles]).sum() < 0:
        triangles = triangles[:, ::-1]
    assembly.add_mesh(name, places, triangles)
