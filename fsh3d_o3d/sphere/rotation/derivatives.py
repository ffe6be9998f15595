"""Linear forms of Wigner's D: a correlation, its gradient and its Hessian.

With products M of real coefficients, C(R) = Σ D(m, m') X(m, m') where X = conj(U) M Uᵀ and U takes real to complex
coefficients. A small rotation exp(ω) in front acts on the rows of D as exp(−iω·J), so that derivatives of C are the
same sum over other X, made by the angular momenta J acting on m. They are made once and serve every rotation.
"""

from __future__ import annotations

import numpy as np

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.sphere.rotation.wigner import Complex128Array, WignerTable


class Derivatives:
    """The linear forms for products of one bandwidth, in the layout of a ``WignerTable``."""

    def __init__(self, table: WignerTable) -> None:
        degree, order = table.degree, table.order
        self._count = len(degree)
        # Rows m = −1 and −2 as well, which J₋ and J₋² of m = 0 and 1 need; what is outside of a degree reads a zero.
        rows = np.concatenate([order, *(order[order == 0] - lower for lower in (1, 2))])
        columns = np.concatenate([table.other, *([table.other[order == 0]] * 2)])
        degrees = np.concatenate([degree, *([degree[order == 0]] * 2)])
        inside = rows >= -degrees
        rows, columns, degrees = rows[inside], columns[inside], degrees[inside]
        # X(m, m') mixes the four entries of M at ±|m|, ±|m'|.
        start, width = degrees * (4 * degrees**2 - 1) // 3, 2 * degrees + 1
        self._entries = np.stack(
            [
                start + (degrees + above * np.abs(rows)) * width + degrees + right * np.abs(columns)
                for above in (1, -1)
                for right in (1, -1)
            ]
        )
        (p, q), (r, s) = _unitary(rows), _unitary(columns)
        self._real = np.stack((p * r, q * s))
        self._imaginary = np.stack((p * s, -q * r))
        b = table.bandwidth
        where = np.full((b, b + 5, 2 * b - 1), len(rows))
        where[degrees, rows + 2, columns + b - 1] = np.arange(len(rows))
        self._shifted = [where[degree, order + 2 + shift, table.other + b - 1] for shift in (-2, -1, 1, 2)]
        raise_once, lower_once = _ladder(degree, order), _ladder(degree, -order)
        self._ladders = (
            raise_once * _ladder(degree, order - 1),
            raise_once,
            lower_once,
            lower_once * _ladder(degree, -order - 1),
        )
        self._order = order.astype(np.float64)
        self._rest = degree * (degree + 1.0) - order**2
        self._twice = np.where(order == 0, 1.0, 2.0)  # −m adds the conjugate of m

    def mixed(self, products: Float64Array) -> Complex128Array:
        """X (n, N) of products (n, …)."""
        return self._mixed(products)[:, : self._count]

    def weights(self, products: Float64Array) -> Float64Array:
        """Ten forms (n, 10, 2N) on D, seen as real and imaginary parts in turn, of products (n, …).

        C, its derivatives along x, y, z, and its second derivatives xx, yy, zz, xy, xz, yz, of C(exp(ω) R).
        """
        full = self._mixed(products)
        lower2, lower1, upper1, upper2 = (
            np.take(full, place, axis=1) * ladder for place, ladder in zip(self._shifted, self._ladders, strict=True)
        )
        middle, m = full[:, : self._count], self._order
        forms = np.empty((len(products), 10, self._count), dtype=np.complex128)
        forms[:, 0] = middle
        forms[:, 1] = -0.5j * (lower1 + upper1)
        forms[:, 2] = 0.5 * (lower1 - upper1)
        forms[:, 3] = -1j * m * middle
        ends, rest = 0.25 * (lower2 + upper2), 0.5 * self._rest * middle
        forms[:, 4] = -rest - ends
        forms[:, 5] = ends - rest
        forms[:, 6] = -(m**2) * middle
        forms[:, 7] = -0.25j * (lower2 - upper2)
        below, above = (m - 0.5) * lower1, (m + 0.5) * upper1
        forms[:, 8] = -0.5 * (below + above)
        forms[:, 9] = -0.5j * (below - above)
        # The real part of a product is that of the real parts minus that of the imaginary ones.
        forms *= self._twice
        return np.conj(forms, out=forms).view(np.float64)

    def _mixed(self, products: Float64Array) -> Complex128Array:
        """X on the extended rows, and a zero in the end."""
        plus_plus, plus_minus, minus_plus, minus_minus = (products[:, place] for place in self._entries)
        result = np.zeros((len(products), plus_plus.shape[1] + 1), dtype=np.complex128)
        result.real[:, :-1] = plus_plus * self._real[0] + minus_minus * self._real[1]
        result.imag[:, :-1] = plus_minus * self._imaginary[0] + minus_plus * self._imaginary[1]
        return result


def _unitary(order: IntArray) -> tuple[Float64Array, Float64Array]:
    """Return p and q of U: the complex coefficient of order m is p r(|m|) + i q r(−|m|) of real ones r."""
    sign = np.where((order > 0) & (order % 2 == 1), -np.sqrt(0.5), np.sqrt(0.5))
    return np.where(order == 0, 1.0, sign), np.where(order == 0, 0.0, -np.sign(order) * sign)


def _ladder(degree: IntArray, order: IntArray) -> Float64Array:
    """√(l(l+1) − m(m−1)), what J₊ takes from order m − 1 to m; 0 outside of the degree."""
    return np.asarray(np.sqrt(np.maximum(degree * (degree + 1.0) - order * (order - 1.0), 0.0)))
