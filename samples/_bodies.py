"""The sample bodies as formulas: radii r(ω) of directions, implicit fields, curves. All have a size of about 1."""

from __future__ import annotations

import numpy as np
from _surfaces import Field, Mesh, level_set, swept, unit
from _writers import Array, IndexArray
from scipy.special import sph_harm_y

STONE_DEGREE = 8


def uniform(seed: int, *shape: int) -> Array:
    """Numbers in [0, 1) from the raw PCG64 stream, the only one NumPy promises not to change between versions."""
    raw = np.random.PCG64(seed).random_raw(int(np.prod(shape)))
    return (raw >> np.uint64(11)).reshape(shape) * 2.0**-53


def normal(seed: int, *shape: int) -> Array:
    """Standard normal numbers, by Box and Muller's formula."""
    u, v = uniform(seed, 2, *shape)
    return np.sqrt(-2.0 * np.log1p(-u)) * np.cos(2.0 * np.pi * v)


def scattered_directions(seed: int, count: int) -> Array:
    """Unit vectors (count, 3), independent and uniform over the sphere."""
    u, v = uniform(seed, 2, count)
    z, longitude = 2.0 * u - 1.0, 2.0 * np.pi * v
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), z], axis=1)


def _arc(directions: Array, centres: Array) -> Array:
    """Angles (n, m) between unit vectors."""
    return np.arccos(np.clip(directions @ centres.T, -1.0, 1.0))


def bennu_like(directions: Array) -> Array:
    """Radius of a rubble body in the manner of the asteroid Bennu: a spinning top with craters and boulders."""
    x, y, z = directions.T
    ridge = np.exp(-np.sqrt(z**2 + 0.004) / 0.38)  # steepest beside the equator: the profile of a diamond
    square = np.cos(4.0 * np.arctan2(y, x)) * (1.0 - z**2) ** 2
    waves, phases = 14.0 * (uniform(11, 24, 3) - 0.5), 2.0 * np.pi * uniform(12, 24)
    rolling = np.sin(directions @ waves.T + phases).mean(axis=1)
    radius = 0.82 + 0.2 * ridge + 0.015 * square + 0.05 * rolling

    width = 0.14 + 0.3 * uniform(14, 12) ** 2
    reach = _arc(directions, scattered_directions(13, 12)) / width
    bowl = -0.27 * np.clip(1.0 - reach**2, 0.0, None) + 0.06 * np.exp(-(((reach - 1.05) / 0.22) ** 2))
    radius += (width * bowl).sum(axis=1)

    width = 0.075 * (1.0 - 0.98 * uniform(16, 130)) ** -0.3  # a power law: many small boulders, few large ones
    reach = _arc(directions, scattered_directions(15, 130)) / width
    return radius + (0.4 * width * np.clip(1.0 - reach**2, 0.0, None)).max(axis=1)


def bumpy_ellipsoid(directions: Array) -> Array:
    """Radius of the ellipsoid with half axes 1, 0.75, 0.6 under a lattice of smooth bumps of 6 %."""
    bumps = np.prod(np.cos(7.0 * directions + 0.4), axis=1)
    return (1.0 + 0.06 * bumps) / np.linalg.norm(directions / np.array([1.0, 0.75, 0.6]), axis=1)


def stone_coefficients() -> Array:
    """Coefficients ((8 + 1)²,) of the stone: √(4π) for i = 0, else 0.9 cos(1 + 2.4 i) / (l + 1)², with i = l² + l + m.

    The harmonics are real, orthonormal and without the Condon-Shortley phase; m < 0 are the sines.
    """
    index = np.arange((STONE_DEGREE + 1) ** 2)
    degree = np.sqrt(index).astype(int)
    coefficients = 0.9 * np.cos(1.0 + 2.4 * index) / (degree + 1.0) ** 2
    coefficients[0] = np.sqrt(4.0 * np.pi)
    return coefficients


def stone(directions: Array) -> Array:
    """Radius of the stone: a sum of harmonics up to degree 8, so bandwidth 9 describes it without error."""
    x, y, z = directions.T
    colatitude, longitude = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    index = np.arange((STONE_DEGREE + 1) ** 2)
    degree = np.sqrt(index).astype(int)
    order = index - degree * (degree + 1)
    harmonics = (-1.0) ** order * sph_harm_y(degree, np.abs(order), colatitude[:, None], longitude[:, None])
    real = np.where(order == 0, 1.0, np.sqrt(2.0)) * np.where(order < 0, harmonics.imag, harmonics.real)
    return real @ stone_coefficients()


def radial_normals(directions: Array, radius: Field) -> Array:
    """Outward unit normals of the surface r(ω), from central differences of |p| − r(p / |p|)."""
    points = directions * radius(directions)[:, None]

    def level(p: Array) -> Array:
        return np.linalg.norm(p, axis=1) - radius(unit(p))

    steps = 1e-5 * np.eye(3)
    return unit(np.stack([level(points + step) - level(points - step) for step in steps], axis=1))


def gem() -> Mesh:
    """A brilliant-cut gem: a convex polyhedron with sharp edges, 16-sided, table up and culet down."""
    turn = 2.0 * np.pi * np.arange(16) / 16.0

    def ring(angle: Array, radius: float, height: float) -> Array:
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full_like(angle, height)], axis=1)

    points = np.vstack(
        [ring(turn[::2], 0.58, 0.42), ring(turn[1::2], 0.86, 0.27), ring(turn, 1.0, 0.07), ring(turn, 1.0, -0.05)]
    )
    points = np.vstack([points, [[0.0, 0.0, -0.85]]])
    k, j = np.arange(8), np.arange(16)
    table, star, girdle, under = k, 8 + k, 16 + j, 32 + j
    after, around = np.roll(girdle, -1), np.roll(under, -1)
    even, odd, then = girdle[::2], girdle[1::2], np.roll(girdle[::2], -1)
    faces: list[tuple[IndexArray, IndexArray, IndexArray]] = [
        (np.zeros(6, dtype=int), table[1:-1], table[2:]),
        (table, star, np.roll(table, -1)),
        (star, np.roll(star, -1), np.roll(table, -1)),
        (star, even, odd),
        (star, odd, then),
        (star, then, np.roll(star, -1)),
        (girdle, under, around),
        (girdle, around, after),
        (under, np.full(16, 48), around),
    ]
    return Mesh(points, np.concatenate([np.stack(face, axis=1) for face in faces]))


def horn() -> Mesh:
    """A ram's horn: a ribbed tube that tapers along a spiral of one and a half turns. Closed, not star-shaped."""
    decay, length = 0.13, 5.4  # of the spiral e^(-decay t); length along it, before the rise
    thick, thin = 0.3, 0.3 * (1.0 - decay * length)
    cap = np.linspace(0.0, np.pi / 2.0, 7)  # hemispheres at both ends
    arc = np.linspace(thick, length - thin, 76)[1:-1]
    arc = np.concatenate([thick * (1.0 - np.cos(cap)), arc, length - thin * (1.0 - np.cos(cap[::-1]))])
    ends = np.concatenate([np.sin(cap), np.ones(74), np.sin(cap[::-1])])
    reach = 1.0 - decay * arc
    t, rise = -np.log(reach) / decay, -0.16
    flat = np.stack([np.cos(t), np.sin(t), np.zeros_like(t)], axis=1)
    side = np.stack([-np.sin(t), np.cos(t), np.zeros_like(t)], axis=1)
    centres = reach[:, None] * flat + rise * t[:, None] * np.array([0.0, 0.0, 1.0])
    tangents = reach[:, None] * (side - decay * flat) + np.array([0.0, 0.0, rise])
    radii = thick * reach * ends * (1.0 + 0.05 * np.cos(14.0 * t))
    return swept(centres, tangents, flat, np.repeat(radii[:, None], 22, axis=1), closed=False)


def trefoil_knot() -> Mesh:
    """A tube of radius 0.16 about the (2, 3) torus knot: genus 1."""
    t = 2.0 * np.pi * np.arange(144) / 144
    flat = np.stack([np.cos(2 * t), np.sin(2 * t), np.zeros_like(t)], axis=1)
    side = np.stack([-np.sin(2 * t), np.cos(2 * t), np.zeros_like(t)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    reach = 1.0 + 0.42 * np.cos(3 * t)
    centres = reach[:, None] * flat + 0.42 * np.sin(3 * t)[:, None] * up
    tangents = -1.26 * np.sin(3 * t)[:, None] * flat + 2.0 * reach[:, None] * side + 1.26 * np.cos(3 * t)[:, None] * up
    outward = np.cos(3 * t)[:, None] * flat + np.sin(3 * t)[:, None] * up  # normal to the torus: across the knot
    return swept(centres, tangents, outward, np.full((144, 14), 0.16), closed=True)


def _smooth_union(distances: Array, blend: float) -> Array:
    """A smooth minimum of distances (n, parts): parts closer than `blend` flow into each other."""
    least = distances.min(axis=1, keepdims=True)
    return least[:, 0] - blend * np.log(np.exp((least - distances) / blend).sum(axis=1))


def limbs(parts: Array, blend: float) -> Field:
    """The field of a smooth union of tapered capsules; a row of `parts` (m, 8) holds two ends, each with a radius."""
    start, end, thick, thin = parts[:, :3], parts[:, 4:7], parts[:, 3], parts[:, 7]
    axis = end - start
    length = np.maximum(np.sum(axis**2, axis=1), 1e-12)  # a capsule of no length is a ball

    def field(points: Array) -> Array:
        offset = points[:, None] - start
        share = np.clip(np.sum(offset * axis, axis=2) / length, 0.0, 1.0)
        distance = np.linalg.norm(offset - share[..., None] * axis, axis=2)
        return _smooth_union(distance - (thick + share * (thin - thick)), blend)

    return field


def starfish(bends: tuple[float, float, float, float, float]) -> Mesh:
    """Five tapered arms about a dome; `bends` turn their outer halves, in radians. Closed, not star-shaped if bent."""
    angle = 2.0 * np.pi * np.arange(5) / 5.0
    half = np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.zeros(5), np.full(5, 0.15)], axis=1)
    outer = angle + np.array(bends)
    tip = half + np.stack([0.5 * np.cos(outer), 0.5 * np.sin(outer), np.full(5, 0.06), np.full(5, -0.09)], axis=1)
    middle = np.tile([0.0, 0.0, 0.05, 0.2], (5, 1))
    parts = np.concatenate([np.hstack([middle, half]), np.hstack([half, tip])])
    return level_set(limbs(parts, 0.03), (-1.25, -1.25, -0.45), (1.25, 1.25, 0.55), 0.08)


def hand() -> Mesh:
    """An open hand: a palm, four fingers and a thumb, each of two limbs. Closed, not star-shaped."""
    parts = [
        [-0.17, -0.45, 0.00, 0.15, -0.24, 0.10, 0.0, 0.13],  # the palm, from the wrist to the knuckles
        [-0.05, -0.45, 0.00, 0.16, -0.08, 0.13, 0.0, 0.13],
        [0.07, -0.45, 0.00, 0.16, 0.09, 0.12, 0.0, 0.13],
        [0.17, -0.45, 0.00, 0.15, 0.25, 0.06, 0.0, 0.12],
        [-0.27, 0.12, 0.00, 0.10, -0.37, 0.45, 0.03, 0.085],  # the fingers
        [-0.37, 0.45, 0.03, 0.085, -0.43, 0.70, 0.13, 0.07],
        [-0.08, 0.12, 0.00, 0.09, -0.12, 0.53, 0.03, 0.085],
        [-0.12, 0.53, 0.03, 0.085, -0.14, 0.83, 0.14, 0.07],
        [0.11, 0.12, 0.00, 0.09, 0.18, 0.48, 0.03, 0.08],
        [0.18, 0.48, 0.03, 0.08, 0.23, 0.74, 0.14, 0.065],
        [0.27, 0.06, 0.00, 0.09, 0.41, 0.32, 0.03, 0.075],
        [0.41, 0.32, 0.03, 0.075, 0.51, 0.52, 0.12, 0.06],
        [-0.18, -0.36, 0.02, 0.14, -0.50, -0.12, 0.10, 0.10],  # the thumb
        [-0.50, -0.12, 0.10, 0.10, -0.66, 0.12, 0.14, 0.075],
    ]
    return level_set(limbs(np.array(parts), 0.025), (-0.9, -0.8, -0.35), (0.75, 1.05, 0.4), 0.066)


def double_torus() -> Mesh:
    """Two rings that have grown together: genus 2."""

    def field(points: Array) -> Array:
        offset = points[:, None] - np.array([[-0.56, 0.0, 0.0], [0.56, 0.0, 0.0]])
        return _smooth_union(np.hypot(np.hypot(offset[..., 0], offset[..., 1]) - 0.5, offset[..., 2]) - 0.19, 0.05)

    return level_set(field, (-1.4, -0.85, -0.35), (1.4, 0.85, 0.35), 0.12)
