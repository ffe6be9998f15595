"""The descriptor over a conformal map as something that whole libraries are described by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d.adapters.geometry import MeshArrays, PointArrays
from fsh3d_o3d.descriptors import CPSHDOption, cpshd_descriptor, descriptor_distances

__all__ = ["CPSHDDescriptor"]


@dataclass(frozen=True)
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
