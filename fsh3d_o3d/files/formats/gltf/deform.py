"""How vertices of a glTF mesh move before it is placed: morph targets and skins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.errors import GeometryReadError
from fsh3d_o3d.files.formats.gltf.accessors import GltfAccessors
from fsh3d_o3d.files.formats.gltf.document import GltfDocument, listed
from fsh3d_o3d.files.formats.gltf.scene import GltfScene
from fsh3d_o3d.files.formats.gltf.transforms import composed, mirrors

# Of the sum of a vertex's weights: what rounding four of them to eight bits may lose, and a little more.
_SUM_TOLERANCE = 0.02
_CHUNK = 1 << 16  # vertices whose blended matrices are held at once, 6 MB


@dataclass(frozen=True, eq=False)
class Skin:
    """What moves the vertices of a mesh with a skin; its node does not."""

    matrices: Float64Array
    """(j, 3, 4) from the mesh to the scene, one for each joint."""

    @classmethod
    def of(cls, document: GltfDocument, accessors: GltfAccessors, scene: GltfScene, index: int) -> Skin:
        """Return a skin of a file."""
        entry = document.entry("skins", index)
        joints = listed(entry, "joints")
        for joint in joints:
            document.entry("nodes", joint)
        if not joints:
            raise GeometryReadError(f"damaged: skin {index} has no joints")
        transforms = scene.transforms(cast(list[int], joints))
        if "inverseBindMatrices" in entry:
            inverse = accessors.numbers(entry["inverseBindMatrices"], ("MAT4",))
            if len(inverse) < len(joints):
                raise GeometryReadError(f"damaged: skin {index} has {len(joints)} joints and {len(inverse)} matrices")
            columns = inverse[: len(joints)].reshape(-1, 4, 4)
            transforms = composed(transforms, columns.transpose(0, 2, 1)[:, :3])
        return cls(transforms)

    def moved(self, points: Float64Array, joints: IntArray, weights: Float64Array) -> Float64Array:
        """Return points (n, 3) blended between joints (n, k) by weights (n, k) that add up to 1."""
        result = np.empty_like(points)
        for begin in range(0, len(points), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            blended = np.zeros((len(points[part]), 3, 4))
            for joint, weight in zip(joints[part].T, weights[part].T, strict=True):
                blended += weight[:, None, None] * self.matrices[joint]
            result[part] = np.einsum("nij,nj->ni", blended[:, :, :3], points[part]) + blended[:, :, 3]
        return result

    def mirrors(self, joints: IntArray, weights: Float64Array) -> bool:
        """Return whether it turns a surface inside out, for most of its vertices."""
        shares = np.bincount(joints.ravel(), weights.ravel(), minlength=len(self.matrices))
        return bool(shares[mirrors(self.matrices)].sum() > shares.sum() / 2)

    def influences(
        self, document: GltfDocument, joints: Float64Array, weights: Float64Array
    ) -> tuple[IntArray, Float64Array]:
        """Return joints and weights (n, k) as they are used: within range, and adding up to 1.

        Raises:
            GeometryReadError: A vertex depends on a joint that is not there.
        """
        names = joints.astype(np.int64)
        beyond = (names >= len(self.matrices)) & (weights != 0)
        if beyond.any():
            raise GeometryReadError(
                f"damaged: a vertex follows joint {names[beyond][0]} of a skin with {len(self.matrices)}"
            )
        names = np.minimum(names, len(self.matrices) - 1)
        weights = weights.copy()
        sums = weights.sum(axis=1)
        alone = sums == 0
        weights[alone, 0] = 1  # as viewers do: it follows the first joint that it names
        off = int((np.abs(sums - 1) > _SUM_TOLERANCE).sum())
        if off:
            document.source.note(f"weights that do not add up to 1 were normalised, at vertices: {off}")
        return names, weights / np.where(alone, 1, sums)[:, None]
