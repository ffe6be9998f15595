"""The spherical harmonic descriptor as something that whole libraries are described by."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.adapters.geometry import MeshArrays, PointArrays
from fsh3d_o3d.descriptors import SHDOption, descriptor_distances, shd_descriptor
from fsh3d_o3d.sphere.grids import equiangular_grid
from fsh3d_o3d.sphere.weights import driscoll_healy_weights

__all__ = ["SHDDescriptor", "on_equiangular_grid"]


@dataclass(frozen=True)
class SHDDescriptor:
    """A ``Descriptor`` of ``shd_descriptor`` with one option."""

    option: SHDOption
    """What is computed, and how descriptors are compared."""

    @property
    def fingerprint(self) -> str:
        """The option's."""
        return self.option.fingerprint

    def describe(self, geometry: MeshArrays | PointArrays) -> NDArray[np.float32]:
        """Return the descriptor (d,)."""
        return shd_descriptor(geometry, self.option)

    def distances(self, queries: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[Any]:
        """Return the distances (n, m) in the option's metric."""
        return descriptor_distances(queries, others, self.option)


def on_equiangular_grid(option: SHDOption) -> SHDOption:
    """Return the same option on the 2b × 2b grid with Driscoll–Healy weights: the paper's SHD-ESH."""
    b = option.bandwidth
    return dataclasses.replace(option, grid=equiangular_grid(b), weights=driscoll_healy_weights(b))
