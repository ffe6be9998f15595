"""Möbius transformations of the sphere: centring, and a rotation that follows the surface."""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array

_STEPS = 60  # of Newton, and halvings of each, at most: 2⁻⁶⁰ is below rounding
_CENTERED = 1e-12  # length of the mean position, in radii of the sphere; some thousand roundings of float64


def centered(sphere: Float64Array, weights: Float64Array) -> Float64Array:
    """Return the sphere map moved by the Möbius transformation that brings its centre of mass to the origin.

    Newton steps in the ball (Baden, Crane and Kazhdan, Möbius Registration, 2018), each made at the current map so that
    crowded positions spread before they are moved on. The transformation is unique up to a rotation, and the one made
    of these steps does not depend on the pose of the map.

    Args:
        sphere: (n, 3) unit vectors.
        weights: (n,) masses, none of them half of the sum or more.
    """
    mass = weights / weights.sum()
    mean = _mean(sphere, mass)
    length = float(np.linalg.norm(mean))
    for _ in range(_STEPS):
        if length <= _CENTERED:
            break
        # A small inversion with centre c moves s by 2 (c − (c·s) s).
        jacobian = 2 * (np.eye(3) - np.einsum("n,ni,nj->ij", mass, sphere, sphere))
        step = np.linalg.solve(jacobian + 1e-15 * np.eye(3), -mean)
        step *= min(1.0, 0.9 / max(float(np.linalg.norm(step)), 1e-300))
        for _ in range(_STEPS):
            moved = inverted(sphere, step)
            new_mean = _mean(moved, mass)
            new_length = float(np.linalg.norm(new_mean))
            if new_length < length:
                break
            step = step / 2
        else:
            break  # as near as float64 gets
        sphere, mean, length = moved, new_mean, new_length
    return sphere


def inverted(sphere: Float64Array, center: Float64Array) -> Float64Array:
    """Return (1 − |c|²) (s + c) / |s + c|² + c: a conformal map of the sphere (n, 3) for a point c of the open ball."""
    shifted = sphere + center
    square = (shifted * shifted).sum(axis=1, keepdims=True)
    return normalized((1 - float((center * center).sum())) * shifted / square + center)


def aligned(sphere: Float64Array, vertices: Float64Array, weights: Float64Array) -> Float64Array:
    """Return the map rotated so that positions and vertices seen from their centre agree best, Σ w s·(v − v̄).

    So the map turns with the surface. Where the surface is nearly symmetric the best rotation hangs by little, and two
    poses of the surface may then get maps that differ by a rotation.
    """
    mass = weights / weights.sum()
    about = vertices - _mean(vertices, mass)
    u, _, vt = np.linalg.svd(np.einsum("n,ni,nj->ij", mass, about, sphere))
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    return normalized(np.einsum("nj,ij->ni", sphere, u @ vt))


def normalized(points: Float64Array) -> Float64Array:
    """Return points (n, 3) divided by their lengths."""
    return np.asarray(points / np.sqrt((points * points).sum(axis=1, keepdims=True)))


def _mean(points: Float64Array, mass: Float64Array) -> Float64Array:
    return np.asarray(np.einsum("n,ni->i", mass, points))
