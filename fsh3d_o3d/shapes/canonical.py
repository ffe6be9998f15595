"""The canonical pose of a shape."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d.shapes.radial import RadialShape
from fsh3d_o3d.shapes.shell import ShellShape
from fsh3d_o3d.sphere import CanonicalPose, canonical_pose

__all__ = ["canonical_rotation"]


def canonical_rotation(shape: object) -> CanonicalPose:
    """Find the rotation that takes a shape to a pose of its own, the same however the input was rotated.

    ``shape.rotated(pose)`` or ``shape.rotated(pose.rotation)`` is the shape in that pose. Poses of different shapes
    have nothing to do with each other: to compare two shapes, use ``estimate_rotation``.

    Args:
        shape: ``RadialShape``, ``ShellShape``, or coefficients (…, b²) of functions that are rotated together. Poses
            are comparable among shapes of the same kind with the same field and number of shells.

    Returns:
        ``CanonicalPose``: the rotation, its margin over the next best one, and the symmetries of the shape.

    Raises:
        ValueError: The shape is a sphere about its centre, for which every pose is alike; or coefficients are
            malformed.
        TypeError: Neither a shape nor an array.

    Example:
        >>> stone = fsh.read_geometry("samples/stone_degree8.ply")
        >>> shape = fsh.RadialShape.from_geometry(stone, bandwidth=9)
        >>> turned = shape.rotated([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
        >>> first, second = shape.rotated(fsh.canonical_rotation(shape)), turned.rotated(fsh.canonical_rotation(turned))
        >>> np.allclose(first.coefficients, second.coefficients, atol=1e-6)
        True
    """
    if isinstance(shape, RadialShape | ShellShape):
        return canonical_pose(shape.coefficients)
    if np.asarray(shape).dtype.kind not in "fiu":
        raise TypeError(f"shape must be a RadialShape, ShellShape or coefficients (…, b²), got {type(shape).__name__}")
    return canonical_pose(shape)
