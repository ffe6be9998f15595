"""The energy that area balancing minimises: how far a map is from conformal and from a wanted area density.

With F the linear map of a source triangle onto its image, of singular values σ₁ ≥ σ₂ and determinant J,

    E = Σ_T w_T [ ½ (σ₁/σ₂ + σ₂/σ₁) + α log²(area of the image / wanted area) ],    Σ_T w_T = 1,

w_T being the share of the surface's area. The first term, the quasi-conformal ratio of Hormann and Greiner's MIPS
(2000), is |F|²/2J; it is 1 where F is conformal and grows without bound where a triangle is about to flip, so that it
keeps a descending sequence of maps valid. The image's area is taken as half of det[a, b, c], which is the area of the
flat triangle times its distance from the centre: it changes sign exactly where the spherical triangle flips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.geometry import triangle_normals
from fsh3d_o3d.sphere_map.validity import cross

_FLATTEST = (
    1e-2  # height over longest edge, a choice: flatter source triangles count as this flat, which no σ₁/σ₂ then notices
)
_SMALLEST = 1e-3  # of the mean area, a choice: smaller triangles weigh as much and want as much of the sphere


@dataclass(frozen=True, eq=False)
class BalanceEnergy:
    """The energy of one mesh; made by ``balance_energy``. Points are held column by column, as (3, n) arrays."""

    triangles: IntArray
    """(3, t) corners, turned so that the first two bound the longest edge."""
    count: int
    """Number of vertices n."""
    gradients: Float64Array
    """(3, 2, t) gradients of the corners' hat functions in the source triangle: F = Σ_k x_k ⊗ g_k."""
    source: Float64Array
    """(t,) areas of the source triangles that the gradients belong to."""
    wanted: Float64Array
    """(t,) areas wanted on the sphere, summing to 4π."""
    weights: Float64Array
    """(t,) share of the surface's area, summing to 1."""
    area_weight: float
    """α."""

    def value(self, sphere: Float64Array) -> float:
        """Return the energy of a map (3, n); infinite where a triangle is not positive."""
        terms = self._terms(sphere)
        return np.inf if terms is None else terms.energy

    def gradient(self, sphere: Float64Array) -> Float64Array:
        """Return the derivative (3, n) of the energy of a valid map with regard to each coordinate."""
        terms = self._terms(sphere)
        if terms is None:
            raise ValueError("the map must be valid: every spherical triangle positive")
        a, edges, normal, twice = terms.corner, terms.edges, terms.normal, terms.twice
        g = self.gradients
        per_stretch = self.weights * 2 * self.source / twice
        per_area = self.weights * (2 * self.area_weight * terms.log_ratio - terms.conformal) / twice
        total = np.zeros((self.count, 3))
        # det[a, b, c] = a · (b−a) × (c−a), whose derivatives by b and c are (c−a) × a and a × (b−a).
        by_b, by_c = cross(edges[1], a), cross(a, edges[0])
        for k, area_part in enumerate((normal - by_b - by_c, by_b, by_c)):
            stretch_part = terms.columns[0] * g[k, 0] + terms.columns[1] * g[k, 1]
            part = per_stretch * stretch_part + per_area * area_part
            for axis in range(3):
                total[:, axis] += np.bincount(self.triangles[k], part[axis], self.count)
        return np.ascontiguousarray(total.T)

    def factors(self, sphere: Float64Array, tangents: Float64Array) -> Float64Array:
        """Return R (4, 6, t), of which RᵀR (6, 6, t) is each triangle's positive semidefinite part of the Hessian.

        In the plane of a triangle the energy is a function of σ₁ and σ₂, and the Hessian with regard to F has four
        known eigenmatrices: two that stretch, one that rotates and one that reflects (Smith, de Goes, Kim 2019).
        Negative eigenvalues count as zero; that the sphere bends away from the plane is left out.

        Args:
            sphere: (3, n) valid map.
            tangents: (2, 3, n) two orthonormal tangents at each vertex, in which steps are expressed.

        Returns:
            (4, 6, t); the six columns are the steps of corners a, b, c along their first and second tangents.
        """
        corners = [sphere[:, index] for index in self.triangles]
        normal = corners[0] + corners[1] + corners[2]
        normal /= np.sqrt(_dot(normal, normal))
        first = corners[1] - corners[0]
        first -= _dot(first, normal) * normal
        first /= np.sqrt(_dot(first, first))
        plane = (first, cross(normal, first))
        g = self.gradients
        linear = [[sum(_dot(plane[i], corners[k]) * g[k, j] for k in range(3)) for j in (0, 1)] for i in (0, 1)]
        modes = self._modes(linear)
        result = np.empty((4, 6, g.shape[2]))
        for k, index in enumerate(self.triangles):
            for d in range(2):
                tangent = tangents[d][:, index]
                along = [_dot(axis, tangent) for axis in plane]
                for r, mode in enumerate(modes):
                    by_first = mode[0][0] * g[k, 0] + mode[0][1] * g[k, 1]
                    by_second = mode[1][0] * g[k, 0] + mode[1][1] * g[k, 1]
                    np.add(by_first * along[0], by_second * along[1], out=result[r, 2 * k + d])
        return result

    def _modes(self, linear: list[list[Float64Array]]) -> list[list[list[Float64Array]]]:
        """Return the four eigenmatrices of the Hessian at F, each times the root of its eigenvalue, 0 if negative."""
        # F = R(u) diag(σ₁, σ₂) R(v): from its parts that commute with rotations and with reflections.
        same, twist = (linear[0][0] + linear[1][1]) / 2, (linear[1][0] - linear[0][1]) / 2
        mirror, shear = (linear[0][0] - linear[1][1]) / 2, (linear[1][0] + linear[0][1]) / 2
        one, other = np.arctan2(shear, mirror), np.arctan2(twist, same)
        large, small = np.hypot(same, twist), np.hypot(mirror, shear)
        s1 = large + small
        s2 = np.maximum(large - small, 1e-8 * s1)  # in the plane, not on the sphere, rounding may flip a needle
        u, v = (other + one) / 2, (other - one) / 2
        area = s1 * s2
        log_ratio = np.log(area * self.source / self.wanted)
        weight = 2 * self.area_weight
        d11 = s2 / s1**3 + weight * (1 - log_ratio) / s1**2
        d22 = s1 / s2**3 + weight * (1 - log_ratio) / s2**2
        d12 = -(s1**2 + s2**2) / (2 * area**2) + weight / area
        middle, radius = (d11 + d22) / 2, np.hypot((d11 - d22) / 2, d12)
        angle = np.arctan2(d12, (d11 - d22) / 2) / 2
        turn = -(((s1 - s2) / area) ** 2) / 2 + weight * log_ratio / area
        reflect = (area + s1**2 + area + s2**2) / (2 * area**2) - weight * log_ratio / area
        roots = [
            np.sqrt(self.weights * np.maximum(value, 0.0))
            for value in (middle + radius, middle - radius, turn, reflect)
        ]
        c, s = np.cos(angle), np.sin(angle)
        zero, half = np.zeros_like(c), np.full_like(c, np.sqrt(0.5))
        plain = ((c, zero, zero, s), (-s, zero, zero, c), (zero, -half, half, zero), (zero, half, half, zero))
        cu, su, cv, sv = np.cos(u), np.sin(u), np.cos(v), np.sin(v)
        modes = []
        for root, (m00, m01, m10, m11) in zip(roots, plain, strict=True):
            left = ((cu * m00 - su * m10, cu * m01 - su * m11), (su * m00 + cu * m10, su * m01 + cu * m11))
            modes.append([[root * (x * cv + y * sv), root * (y * cv - x * sv)] for x, y in left])
        return modes

    def _terms(self, sphere: Float64Array) -> _Terms | None:
        a, b, c = (sphere[:, index] for index in self.triangles)
        edges = (b - a, c - a)
        normal = cross(*edges)
        twice = _dot(a, normal)
        if not np.all(twice > 0):
            return None
        g = self.gradients
        columns = (edges[0] * g[1, 0] + edges[1] * g[2, 0], edges[0] * g[1, 1] + edges[1] * g[2, 1])
        stretch = _dot(columns[0], columns[0]) + _dot(columns[1], columns[1])
        conformal = stretch * self.source / twice
        log_ratio = np.log(twice / (2 * self.wanted))
        energy = float(self.weights @ (conformal + self.area_weight * log_ratio**2))
        return _Terms(a, edges, normal, twice, columns, conformal, log_ratio, energy)


@dataclass(frozen=True, eq=False)
class _Terms:
    """What value and gradient share."""

    corner: Float64Array
    """(3, t) corner a."""
    edges: tuple[Float64Array, Float64Array]
    """b − a and c − a."""
    normal: Float64Array
    """(b − a) × (c − a)."""
    twice: Float64Array
    """(t,) det[a, b, c]."""
    columns: tuple[Float64Array, Float64Array]
    """The two columns (3, t) of F."""
    conformal: Float64Array
    """(t,) ½ (σ₁/σ₂ + σ₂/σ₁)."""
    log_ratio: Float64Array
    """(t,) log of image area over wanted area."""
    energy: float
    """Sum over the triangles."""


def balance_energy(
    vertices: Float64Array, triangles: IntArray, *, area_weight: float, density: Float64Array | None = None
) -> BalanceEnergy:
    """Return the energy of maps of a mesh.

    Triangles without area are given some: flatter than 1 : 100 they count as that flat, smaller than a thousandth
    of the mean they weigh and want that much, so that they neither become NaN nor rule.

    Args:
        vertices: (n, 3) positions on the surface.
        triangles: (t, 3) corners.
        area_weight: α ≥ 0.
        density: (t,) positive; the sphere's share wanted for each triangle is its area times this. Default: 1.
    """
    corners = vertices[triangles]
    squared = np.square(np.roll(corners, -1, axis=1) - corners).sum(axis=2)
    start = np.argmax(squared, axis=1)
    turned = np.take_along_axis(triangles, (start[:, None] + np.arange(3)) % 3, axis=1)
    a, b, c = np.moveaxis(vertices[turned], 1, 0)
    area = np.linalg.norm(triangle_normals(vertices[turned]), axis=1) / 2
    unit = np.sqrt(area.sum() / (4 * np.pi))
    area = area / unit**2
    floor = _SMALLEST * 4 * np.pi / len(area)
    length = np.sqrt(squared.max(axis=1)) / unit
    base = np.maximum(length, np.sqrt(floor))
    where = np.einsum("ij,ij->i", b - a, c - a) / np.where(length > 0, length * unit, 1.0) ** 2
    foot = np.where(length > 0, where, 0.5) * base
    height = np.maximum(2 * area / base, _FLATTEST * base)
    gradients = np.zeros((3, 2, len(area)))
    gradients[1, 0], gradients[1, 1], gradients[2, 1] = 1 / base, -foot / (base * height), 1 / height
    gradients[0] = -gradients[1] - gradients[2]
    weights = np.maximum(area, floor)
    wanted = weights if density is None else weights * density
    return BalanceEnergy(
        triangles=np.ascontiguousarray(turned.T),
        count=len(vertices),
        gradients=gradients,
        source=base * height / 2,
        wanted=wanted * (4 * np.pi / wanted.sum()),
        weights=weights / weights.sum(),
        area_weight=area_weight,
    )


def _dot(p: Float64Array, q: Float64Array) -> Float64Array:
    return np.asarray(p[0] * q[0] + p[1] * q[1] + p[2] * q[2])
