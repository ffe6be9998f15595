"""What is found in an index."""

from __future__ import annotations

from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value

__all__ = ["Hit", "IndexSummary", "IndexedModel", "NearDuplicate"]


@value
class Hit:
    """One model that a query found. Arrays are read-only."""

    path: str
    """The file, absolute, as it was when it was indexed."""
    distance: float
    """How unlike the query it is, in [0, 2]: of the features, and where re-ranked mixed with that once aligned."""
    rank: int
    """1 for the most similar."""
    rotation: Float64Array
    """(3, 3): turns the model as the query lies."""
    transformation: Float64Array
    """(4, 4): moves, turns and scales the model onto the query, centroid on centroid and RMS radius to RMS radius."""
    feature_distance: float
    """Of the rotation-invariant features alone."""
    vertices: int
    """Vertices of the mesh, or points of the cloud."""
    triangles: int
    """Triangles; 0 for a cloud."""
    watertight: bool
    """Whether every edge belongs to exactly two triangles once equal vertices are one."""
    thumbnail: bytes
    """A PNG as drawn when it was indexed; empty if none was."""


@value
class NearDuplicate:
    """Two models of an index that are almost the same shape, whatever their pose, size and triangulation."""

    first: str
    """A file."""
    second: str
    """The other."""
    distance: float
    """Of their features."""
    mirrored: bool = False
    """Whether they only fit as mirror images: a left and a right part, which features cannot tell apart."""


@value
class IndexedModel:
    """What an index knows of a file, apart from its shape."""

    path: str
    """The file, absolute."""
    size: int
    """Bytes; of a ``.gltf`` with those of all buffers in its folder."""
    changed: int
    """Time of the file's last change when it was indexed, in nanoseconds since 1970."""
    vertices: int
    """Vertices of the mesh, or points of the cloud."""
    triangles: int
    """Triangles; 0 for a cloud."""
    watertight: bool
    """Whether every edge belongs to exactly two triangles once equal vertices are one."""


@value
class IndexSummary:
    """What an index is."""

    format: int
    """Version of its tables."""
    models: int
    """Files that can be found."""
    failures: int
    """Files that could not be described."""
    libraries: dict[str, int]
    """Folders that were indexed as libraries, and how many models each has."""
    single_files: int
    """Models of files that belong to none of these."""
    searchable: int
    """Models in the structure by which a large index is searched; 0: a query is compared with every model."""
    bytes_on_disk: int
    """Of all its files, those of versions before included."""
