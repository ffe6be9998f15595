"""The spherical harmonic descriptor as something that whole libraries are described by."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._progress import progress_bar
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d._value import value
from fsh3d_o3d.descriptors.shd import (
    CPSHDOption,
    SHDOption,
    compute_signature,
    cpshd_descriptor,
    descriptor_distances,
    shd_descriptor,
)
from fsh3d_o3d.descriptors.signature_distance import mixed_distances, signature_distances
from fsh3d_o3d.geometry import MeshArrays, PointArrays
from fsh3d_o3d.sphere import driscoll_healy_weights, equiangular_grid

__all__ = [
    "CPSHDDescriptor",
    "SHDDescriptor",
    "on_equiangular_grid",
]

Option = TypeVar("Option", SHDOption, CPSHDOption)

_ALIGNED_DEGREES = 8  # degrees below this are aligned; as many as an index keeps


@value
class SHDDescriptor:
    """A ``Descriptor`` of ``shd_descriptor`` with one option, with or without re-ranking by the best rotation."""

    option: SHDOption
    """What is computed, and how descriptors are compared."""
    rerank: int | None = None
    """The candidates nearest to a query, this many, are aligned with it and ranked anew; None: none are. Descriptors
    then hold the coefficients behind the feature, too."""

    def __post_init__(self) -> None:
        if self.rerank is not None:
            check.integer(self.rerank, "rerank", minimum=1)
            check.integer(self.option.bandwidth, "bandwidth of a re-ranked option", minimum=2)

    @property
    def fingerprint(self) -> str:
        """The option's, and whether coefficients follow the feature."""
        return self.option.fingerprint + ("" if self.rerank is None else f" and {self._bandwidth} aligned degrees")

    @property
    def _bandwidth(self) -> int:
        return min(_ALIGNED_DEGREES, self.option.bandwidth)

    def describe(self, geometry: MeshArrays | PointArrays) -> NDArray[np.float32]:
        """Return the descriptor (d,)."""
        if self.rerank is None:
            return shd_descriptor(geometry, self.option)
        signature = compute_signature(geometry, self.option, bandwidth=self._bandwidth)
        return np.concatenate((signature.feature, signature.coefficients.ravel()))

    def distances(
        self, queries: NDArray[np.float32], others: NDArray[np.float32], *, progress: bool = False
    ) -> NDArray[Any]:
        """Return the distances (n, m) in the option's metric.

        With ``rerank`` those of each query's nearest are mixed with the aligned ones; all others follow behind.
        """
        if self.rerank is None:
            return descriptor_distances(queries, others, self.option)
        length = self.option.feature_shape[0] * self.option.feature_shape[1]
        features = descriptor_distances(queries[:, :length], others[:, :length], self.option)
        shape = (-1, (queries.shape[1] - length) // self._bandwidth**2, self._bandwidth**2)
        rows, columns = queries[:, length:].reshape(shape), others[:, length:].reshape(shape)
        same = queries is others
        nearest = _nearest(features, self.rerank, same)
        aligned = _aligned(rows, columns, nearest, same, progress)
        return np.where(nearest, mixed_distances(features, aligned), features + (features.max() + 2))


def _nearest(distances: Float64Array, count: int, same: bool) -> NDArray[np.bool_]:
    """Which (n, m) are among the ``count`` nearest of their row; a shape is always so to itself."""
    chosen = np.zeros(distances.shape, dtype=bool)
    order = np.argsort(distances, axis=1, kind="stable")[:, : count + same]
    np.put_along_axis(chosen, order, True, axis=1)
    if same:
        np.fill_diagonal(chosen, True)
    return chosen


def _aligned(
    rows: NDArray[np.float32], columns: NDArray[np.float32], wanted: NDArray[np.bool_], same: bool, progress: bool
) -> Float64Array:
    """The aligned distances (n, m) where they are wanted, 0 elsewhere; each pair once where both sets are the same."""
    result = np.zeros(wanted.shape)
    bar = progress_bar(len(rows), wanted=progress, desc="aligning", unit="model")
    for index in range(len(rows)):
        bar.update()
        chosen = wanted[index]
        if same:
            chosen = (chosen | wanted[:, index]) & (np.arange(len(columns)) > index)
        chosen = np.flatnonzero(chosen)
        if len(chosen):
            result[index, chosen], _ = signature_distances(rows[index], columns[chosen])
        if same:
            result[chosen, index] = result[index, chosen]
    bar.close()
    return result


def on_equiangular_grid(option: Option) -> Option:
    """Return the same option on the 2b × 2b grid with Driscoll–Healy weights: the paper's ESH."""
    b = option.bandwidth
    return dataclasses.replace(option, grid=equiangular_grid(b), weights=driscoll_healy_weights(b))


@value
class CPSHDDescriptor:
    """A ``Descriptor`` of ``cpshd_descriptor`` with one option."""

    option: CPSHDOption
    """What is computed, and how descriptors are compared."""

    @property
    def fingerprint(self) -> str:
        """The option's."""
        return self.option.fingerprint

    def describe(self, geometry: MeshArrays | PointArrays) -> NDArray[np.float32]:
        """Return the descriptor (d,)."""
        return cpshd_descriptor(geometry, self.option)

    def distances(
        self, queries: NDArray[np.float32], others: NDArray[np.float32], *, progress: bool = False
    ) -> NDArray[Any]:
        """Return the distances (n, m) in the option's metric."""
        return descriptor_distances(queries, others, self.option)
