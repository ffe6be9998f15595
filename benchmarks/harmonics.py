"""Every harmonic against SciPy's, and both against extended precision by another recursion.

Near the poles dY/dz reaches 2000 at degree 40: the rounding of z alone moves a harmonic by 2e-13. So directions are
made from angles, with z = cos θ as SciPy computes it, and both sides start from the same number. Beside it stands the
same on a Fibonacci grid, where z is given and SciPy gets it back from a rounded angle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import sph_harm_y

import fsh3d_o3d as fsh
from benchmarks._measure import interleave, limited
from benchmarks._table import Cell, Check, Column, Curve, Plot, Row, Table


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of deviations by degree."""
    count = 100 if quick else 2000
    rng = np.random.default_rng(40)
    theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    directions = np.stack([x, y, z], axis=1)
    degrees = (4, 8) if quick else (10, 20, 30, 40)
    ours = fsh.spherical_harmonics(directions, degrees[-1] + 1)
    scipy = scipy_harmonics(theta, phi, degrees[-1] + 1)
    grid = fsh.fibonacci_grid(count)
    ours_there = fsh.spherical_harmonics(grid.directions, degrees[-1] + 1)
    scipy_there = scipy_harmonics(grid.colatitude, grid.longitude, degrees[-1] + 1)
    exact = extended_harmonics(directions, degrees[-1] + 1)
    rows = []
    for degree in degrees:
        size = (degree + 1) ** 2
        with limited(1):
            times = interleave(
                {
                    "ours": partial(fsh.spherical_harmonics, directions, degree + 1),
                    "scipy": partial(scipy_harmonics, theta, phi, degree + 1),
                },
                rounds=5,
            )
        deviation = float(np.abs(ours - scipy)[:, :size].max())
        cells: dict[str, Cell] = {
            "degree": degree,
            "harmonics": size,
            "deviation": deviation,
            "rounded": float(np.abs(ours_there - scipy_there)[:, :size].max()),
            "ours_error": float(np.abs(ours - exact)[:, :size].max()),
            "scipy_error": float(np.abs(scipy - exact)[:, :size].max()),
            "ours": times["ours"],
            "scipy": times["scipy"],
            "ratio": times["scipy"].over(times["ours"]),
        }
        rows.append(Row(cells, (Check("deviation", deviation, "<=", 1e-13),)))
    curves = tuple(
        Curve(label, list(degrees), [float(row.cells[key]) for row in rows])  # type: ignore[arg-type]
        for label, key in (
            ("ours − SciPy", "deviation"),
            ("ours − extended precision", "ours_error"),
            ("SciPy − extended precision", "scipy_error"),
        )
    )
    yield Table(
        "harmonics",
        f"Real harmonics of every degree and order against scipy.special.sph_harm_y, {count} directions",
        (
            Column("degree", "l ≤"),
            Column("harmonics", "(l, m)"),
            Column("deviation", "max |ours − scipy|", ".1e"),
            Column("rounded", "on Fibonacci grid", ".1e"),
            Column("ours_error", "max |ours − extended|", ".1e"),
            Column("scipy_error", "max |scipy − extended|", ".1e"),
            Column("ours", "ours ms", ".3g", 1e3),
            Column("scipy", "scipy ms", ".3g", 1e3),
            Column("ratio", "scipy / ours", ".1f"),
        ),
        tuple(rows),
        Plot("largest degree", "largest absolute deviation", curves, 1e-13),
        (f"extended: unnormalised recursion in {np.finfo(np.longdouble).nmant + 1}-bit floating point.",),
    )


def scipy_harmonics(theta: NDArray[np.float64], phi: NDArray[np.float64], bandwidth: int) -> NDArray[np.float64]:
    """Return SciPy's harmonics in our real layout at colatitudes and longitudes (n,), (n, b²)."""
    degree, order = fsh.degrees_and_orders(bandwidth)
    kept = order >= 0
    degree, order = degree[kept], order[kept]
    values = sph_harm_y(degree, order, theta[:, None], phi[:, None])
    values *= np.where(order > 0, np.sqrt(2.0), 1.0) * (1.0 - 2.0 * (order % 2))  # without Condon and Shortley's phase
    result = np.empty((len(theta), bandwidth**2))
    result[:, degree * degree + degree - order] = values.imag
    result[:, degree * degree + degree + order] = values.real
    return result


def extended_harmonics(directions: NDArray[np.float64], bandwidth: int) -> NDArray[np.longdouble]:
    """Return the harmonics in extended precision, (n, b²).

    P(l, m) by (l − m) P(l, m) = (2l − 1) z P(l−1, m) − (l + m − 1) P(l−2, m) from P(m, m) = (2m − 1)!! ρ^m, normalised
    with exact factorials; the order of recursion and the scaling differ from the package's.
    """
    x, y, z = directions.astype(np.longdouble).T
    pi = np.longdouble("3.14159265358979323846264338327950288")
    power: NDArray[Any] = np.ones(len(x), dtype=np.clongdouble)  # (x + iy)^m = ρ^m exp(imφ)
    result = np.empty((len(x), bandwidth**2), dtype=np.longdouble)
    for m in range(bandwidth):
        before = np.zeros_like(z)
        current = np.full_like(z, _exact(math.prod(range(1, 2 * m, 2))))
        for degree in range(m, bandwidth):
            if degree > m:
                ahead = ((2 * degree - 1) * z * current - (degree + m - 1) * before) / (degree - m)
                before, current = current, ahead
            ratio = _exact(math.factorial(degree - m)) / _exact(math.factorial(degree + m))
            norm = np.sqrt((2 * degree + 1) / (4 * pi) * ratio * (2 if m else 1))
            centre = degree * degree + degree
            result[:, centre - m] = norm * current * power.imag
            result[:, centre + m] = norm * current * power.real
        power = power * (x + 1j * y)
    return result


def _exact(number: int) -> np.longdouble:
    return np.longdouble(str(number))
