"""Maps between coefficients that are made of a few numbers each: gradients on the sphere and infinitesimal rotations.

Multiplying a harmonic of degree l by x, y or z gives harmonics of degree l + 1 and l − 1 and of order m ± 1 or m. With
U and D for the two parts, the gradient on the sphere of a harmonic is −l U + (l + 1) D along each axis, from
[Δ, x] f = 2 ∇x·∇f + f Δx: the derivatives of a band-limited function are band-limited themselves, one degree higher.
"""

from __future__ import annotations

import functools

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_array
from torch import Tensor

from fsh3d_o3d._validation import Float64Array, IntArray

_NOTHING = 1e-9  # of entries of order one: more than a difference of equal products leaves of rounding


def gradient(coefficients: Tensor) -> Tensor:
    """Coefficients of the three components of the gradient on the sphere: (…, b²) → (…, 3, (b+1)²)."""
    result: Tensor = _apply(coefficients, "gradient", False)
    return result.unflatten(-1, (3, -1))


def turned(coefficients: Tensor) -> Tensor:
    """Derivatives with respect to rotations about x, y, z: (…, b²) → (…, 3, b²)."""
    result: Tensor = _apply(coefficients, "rotation", False)
    return result.unflatten(-1, (3, -1))


@torch.library.custom_op(
    "fsh3d::sparse_map", mutates_args=(), schema="(Tensor values, str kind, bool adjoint) -> Tensor"
)
def _apply(values: Tensor, kind: str, adjoint: bool) -> Tensor:
    """Sums of a few weighted entries each. Opaque to compilers, which would take the tables for inputs."""
    index, weight = _table(kind, _bandwidth(values.shape[-1], kind, adjoint), adjoint, values.dtype, values.device)
    result = values[..., index[0]] * weight[0]
    for place, factor in zip(index[1:], weight[1:], strict=True):
        result.addcmul_(values[..., place], factor)
    return result


@_apply.register_fake
def _(values: Tensor, kind: str, adjoint: bool) -> Tensor:
    b = _bandwidth(values.shape[-1], kind, adjoint)
    wide = 3 * (b + (kind == "gradient")) ** 2
    return values.new_empty((*values.shape[:-1], b * b if adjoint else wide))


def _keep(ctx: object, inputs: tuple[Tensor, str, bool], output: Tensor) -> None:
    _, ctx.kind, ctx.adjoint = inputs  # type: ignore[attr-defined]


def _backward(ctx: object, grad: Tensor) -> tuple[Tensor, None, None]:
    return _apply(grad, ctx.kind, not ctx.adjoint), None, None  # type: ignore[attr-defined]


_apply.register_autograd(_backward, setup_context=_keep)


def _bandwidth(size: int, kind: str, adjoint: bool) -> int:
    """The bandwidth b of the map between b² and 3(b+1)², or 3b², numbers, from the number that goes in."""
    if not adjoint:
        return int(np.sqrt(size) + 0.5)
    return int(np.sqrt(size / 3) + 0.5) - (kind == "gradient")


@functools.lru_cache(maxsize=64)
def _table(kind: str, bandwidth: int, adjoint: bool, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Which entries each result is made of, and their weights: (terms, results) each."""
    matrix = gradient_matrix(bandwidth) if kind == "gradient" else rotation_matrix(bandwidth)
    index, weight = _padded(csr_array(matrix.T) if adjoint else matrix)
    return torch.as_tensor(index, device=device), torch.as_tensor(weight, device=device, dtype=dtype)


def _padded(matrix: csr_array) -> tuple[IntArray, Float64Array]:
    """Rows of a sparse matrix, all with as many entries as the longest: (terms, rows) columns and values."""
    matrix.sort_indices()
    count = np.diff(matrix.indptr)
    row = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(row)) - np.repeat(matrix.indptr[:-1], count)
    terms = max(1, int(count.max(initial=0)))
    index, weight = np.zeros((terms, len(count)), dtype=np.int64), np.zeros((terms, len(count)))
    index[place, row], weight[place, row] = matrix.indices, matrix.data
    return index, weight


def gradient_matrix(bandwidth: int) -> csr_array:
    """(3(b+1)², b²): the components of the gradient on the sphere, one after another."""
    return _stacked([_product(axis, bandwidth, gradient=True) for axis in range(3)])


def rotation_matrix(bandwidth: int) -> csr_array:
    """(3b², b²): f ↦ −(ω × ∇f), the change of f(exp(−t[e])ω) in t about each axis e."""
    b, parts = bandwidth, []
    for first, second in ((1, 2), (2, 0), (0, 1)):
        whole = _product(first, b + 1, gradient=False) @ _product(second, b, gradient=True) - _product(
            second, b + 1, gradient=False
        ) @ _product(first, b, gradient=True)
        part = csr_array(-whole[: b * b])
        part.data[np.abs(part.data) < _NOTHING] = 0
        part.eliminate_zeros()
        parts.append(part)
    return _stacked(parts)


def _stacked(parts: list[csr_array]) -> csr_array:
    rows = np.concatenate([np.repeat(np.arange(part.shape[0]), np.diff(part.indptr)) for part in parts])
    shift = np.repeat(np.cumsum([0, *(part.shape[0] for part in parts[:-1])]), [part.nnz for part in parts])
    columns, data = (np.concatenate([getattr(part, name) for part in parts]) for name in ("indices", "data"))
    shape = (sum(part.shape[0] for part in parts), parts[0].shape[1])
    return csr_array((data, (rows + shift, columns)), shape=shape)


def _product(axis: int, bandwidth: int, *, gradient: bool) -> csr_array:
    """((b+1)², b²): multiplication by x, y or z; or that component of the gradient on the sphere."""
    b = bandwidth
    every = np.meshgrid(np.arange(b), np.arange(b), indexing="ij")
    degrees, orders = (grid.ravel().astype(np.float64) for grid in every)
    kept = orders <= degrees
    degree, m = degrees[kept], orders[kept]
    size = (b + 1) ** 2
    rows: list[NDArray[np.float64]] = []
    columns: list[NDArray[np.float64]] = []
    values: list[NDArray[np.float64]] = []

    def add(sine: bool, step: int, rise: int, target_sine: bool, factor: Float64Array) -> None:
        """Harmonics (l, ±m) to (l + step, ±(m + rise)); a sine of order 0 is none."""
        target_degree, target_order = degree + step, m + rise
        exists = (target_order >= target_sine) & (target_order <= target_degree) & (m >= sine)
        rows.append((target_degree**2 + target_degree + np.where(target_sine, -1, 1) * target_order)[exists])
        columns.append((degree**2 + degree + np.where(sine, -1, 1) * m)[exists])
        weight = (-degree if step > 0 else degree + 1) if gradient else np.ones_like(degree)
        values.append((factor * weight)[exists])

    up, down = (2 * degree + 1) * (2 * degree + 3), np.maximum((2 * degree - 1) * (2 * degree + 1), 1)
    if axis == 2:
        for sine in (False, True):
            add(sine, 1, 0, sine, np.sqrt(((degree + 1) ** 2 - m**2) / up))
            add(sine, -1, 0, sine, np.sqrt((degree**2 - m**2) / down))
    else:
        # sin θ times a Legendre function, half of it with the order above and half with the one below.
        above = np.where(m == 0, np.sqrt(0.5), 0.5)
        below = np.where(m == 1, np.sqrt(0.5), 0.5) * (m >= 1)
        for sine in (False, True):
            other = sine if axis == 0 else not sine  # cos φ keeps the kind, sin φ changes it
            raised = -1.0 if axis == 1 and sine else 1.0
            lowered = -1.0 if axis == 1 and not sine else 1.0
            add(sine, 1, 1, other, raised * above * np.sqrt((degree + m + 1) * (degree + m + 2) / up))
            add(sine, -1, 1, other, -raised * above * np.sqrt(np.maximum((degree - m) * (degree - m - 1), 0) / down))
            add(sine, 1, -1, other, -lowered * below * np.sqrt((degree - m + 1) * (degree - m + 2) / up))
            add(sine, -1, -1, other, lowered * below * np.sqrt((degree + m) * np.maximum(degree + m - 1, 0) / down))
    place = [np.concatenate(part).astype(np.int64) for part in (rows, columns)]
    return csr_array((np.concatenate(values), (place[0], place[1])), shape=(size, b * b))
