"""The transform inside networks: error, and time forward and backward, beside the NumPy layer and peers in PyTorch.

Peers do not transform on Fibonacci grids; each does the round trip of the same coefficients on a grid of its own:
torch-harmonics on Gauss–Legendre rings, e3nn on its equiangular grid. sphericart evaluates harmonics at directions with
their gradients; beside it stands ours at the same directions. Rows of what is not installed are left out.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

import fsh3d_o3d as fsh
from benchmarks._cases import ducc0_adjoint, ducc0_synthesis, fibonacci_case, random_coefficients, relative_error
from benchmarks._measure import Timing, interleave, limited, peak_memory
from benchmarks._table import Cell, Check, Column, Row, Table

_BATCHES = {16: 64, 32: 64, 64: 64, 128: 2}
_ROUND_TRIP = {"float64": 3e-14, "float32": 1e-6}  # targets
_OVER_NUMPY = 2.2  # forward and backward are twice the work of forward
_GIB = 2.0  # of the memory at b = 256
_MEMORY = """
import sys, torch
from fsh3d_o3d import torch as ft
transform = ft.SphericalHarmonicTransform(int(sys.argv[1]))
values = torch.ones(1, len(transform.grid), requires_grad=True)
transform(values).square().sum().backward()
"""


def run(*, quick: bool = False) -> Iterator[Table]:
    """Yield the table of round trips and times, that of evaluation, memory, and that of the device."""
    if importlib.util.find_spec("torch") is None:
        return
    yield _round_trips((8,) if quick else (16, 32, 64, 128))
    yield _evaluation((8,) if quick else (16, 32))
    yield _memory(16 if quick else 256)
    yield _device((8,) if quick else (32, 64, 128))


def _installed(name: str) -> bool:
    return importlib.util.find_spec(name.split(".")[0]) is not None


def _differentiated(function: Callable[[Any], Any], argument: Any) -> Callable[[], Any]:
    """A call forward and backward, from a gradient that is at hand."""
    import torch

    given = argument.detach().requires_grad_()
    with torch.no_grad():
        ahead = torch.randn_like(function(given))
    return lambda: torch.autograd.grad(function(given), given, ahead)


def _round_trips(bandwidths: tuple[int, ...]) -> Table:
    import torch

    from fsh3d_o3d import torch as ft

    rows = []
    for b in bandwidths:
        batch = _BATCHES.get(b, 4)
        coefficients = random_coefficients(b, batch)
        case = fibonacci_case(b)
        for dtype in (torch.float64, torch.float32):
            name = str(dtype).removeprefix("torch.")
            ours = ft.SphericalHarmonicTransform(b, case.grid, case.weights, dtype=dtype)
            plan = fsh.SphericalHarmonicTransform(b, case.grid, case.weights, threads=1)
            given = torch.from_numpy(coefficients).to(dtype)
            values = ours.inverse(given)
            calls: dict[str, Callable[[], Any]] = {
                "ours": _differentiated(ours, values),
                "numpy": partial(plan.forward, values.numpy()),
                "ducc0": partial(_ducc0_both, values.numpy(), case.locations, b - 1),
            }
            errors = {"ours": relative_error(ours(values), coefficients)}
            for peer, (inverse, forward, layout) in _peers(b, dtype).items():
                theirs = layout(given)
                grid = inverse(theirs)
                errors[peer] = relative_error(torch.view_as_real(forward(grid) + 0j), torch.view_as_real(theirs + 0j))
                calls[peer] = _differentiated(forward, grid)
            with limited(1), _one_thread():
                times = interleave(calls, rounds=7, budget=6.0)
            ratio = times["ours"].over(times["numpy"])
            checks = [Check("error", errors["ours"], "<=", _ROUND_TRIP[name])]
            if (b, name) == (32, "float64"):
                checks.append(Check("over NumPy's forward", ratio, "<=", _OVER_NUMPY))
            harmonics = times.get("torch-harmonics")
            if harmonics is not None and b in (32, 64) and name == "float64":
                checks.append(Check("torch-harmonics / ours", harmonics.over(times["ours"]), ">=", 1.0))
            cells: dict[str, Cell] = {"b": b, "batch": batch, "precision": name, "over numpy": ratio}
            for peer in ("ours", "torch-harmonics", "e3nn"):
                cells |= {f"{peer} error": errors.get(peer), f"{peer} time": times.get(peer)}
            cells["ducc0 time"] = times["ducc0"]
            rows.append(Row(cells, tuple(checks)))
    columns = [Column("b", "b", "d"), Column("batch", "batch", "d"), Column("precision", "precision")]
    for peer in ("ours", "torch-harmonics", "e3nn"):
        columns += [Column(f"{peer} error", f"{peer} error", ".1e"), Column(f"{peer} time", f"{peer} ms", ".3g", 1e3)]
    columns += [Column("ducc0 time", "ducc0 ms", ".3g", 1e3), Column("over numpy", "ours / NumPy forward", ".2f")]
    return Table(
        "learning_transform",
        "Round trip in PyTorch, and forward with backward, one thread",
        tuple(columns),
        tuple(rows),
        notes=("ducc0: adjoint and synthesis, one call a function, in NumPy. NumPy: our own forward alone.",),
    )


def _ducc0_both(values: Any, locations: Any, lmax: int) -> None:
    for row in values:
        ducc0_synthesis(ducc0_adjoint(row, locations, lmax, 1), locations, lmax, 1)


def _peers(b: int, dtype: Any) -> dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any], Callable[[Any], Any]]]:
    """Synthesis, analysis, and what turns our coefficients into some of theirs."""
    import torch

    found: dict[str, Any] = {}
    if _installed("torch_harmonics"):
        import torch_harmonics

        sizes = {"nlat": b, "nlon": 2 * b, "lmax": b, "mmax": b, "grid": "legendre-gauss"}
        back, forth = torch_harmonics.InverseRealSHT(**sizes).to(dtype), torch_harmonics.RealSHT(**sizes).to(dtype)

        def triangular(given: Any) -> Any:
            full = torch.zeros(len(given), b, b, dtype=torch.complex128)
            packed = torch.from_numpy(fsh.to_packed(given.double().numpy()))
            degree, order = np.concatenate([[(degree, m) for degree in range(m, b)] for m in range(b)]).T
            full[:, degree, order] = packed
            return full.to(torch.complex128 if dtype == torch.float64 else torch.complex64)

        found["torch-harmonics"] = back, forth, triangular
    if _installed("e3nn") and b <= 32:  # its tables have b⁴ numbers
        from e3nn import o3

        before = torch.get_default_dtype()
        torch.set_default_dtype(dtype)
        try:
            to, back = o3.ToS2Grid(b - 1, (2 * b, 2 * b - 1)), o3.FromS2Grid((2 * b, 2 * b - 1), b - 1)
        finally:
            torch.set_default_dtype(before)
        found["e3nn"] = to, back, lambda given: given
    return found


class _one_thread:  # noqa: N801 - a context
    """PyTorch's own pool, which threadpoolctl does not reach."""

    def __enter__(self) -> None:
        import torch

        self._before = torch.get_num_threads()
        torch.set_num_threads(1)

    def __exit__(self, *_: object) -> None:
        import torch

        torch.set_num_threads(self._before)


def _evaluation(bandwidths: tuple[int, ...]) -> Table:
    """Functions at directions, with the gradient in the directions."""
    import torch

    from fsh3d_o3d import torch as ft

    rows = []
    for b in bandwidths:
        directions = torch.nn.functional.normalize(torch.randn(2000, 3, dtype=torch.float64), dim=-1)
        coefficients = torch.from_numpy(random_coefficients(b, 4))
        calls = {"ours": _differentiated(partial(ft.evaluate, coefficients), directions)}
        expected = fsh.evaluate(coefficients.numpy(), directions.numpy())
        errors = {"ours": relative_error(ft.evaluate(coefficients, directions), expected)}
        if _installed("sphericart.torch"):
            import sphericart.torch

            peer = sphericart.torch.SphericalHarmonics(b - 1)
            calls["sphericart"] = _differentiated(partial(_by_harmonics, peer, coefficients), directions)
            errors["sphericart"] = relative_error(_by_harmonics(peer, coefficients, directions), expected)
        with limited(1), _one_thread():
            times = interleave(calls, rounds=7, budget=4.0)
        rows.append(
            Row(
                {
                    "b": b,
                    **{f"{name} error": errors.get(name) for name in ("ours", "sphericart")},
                    **{f"{name} time": times.get(name) for name in ("ours", "sphericart")},
                }
            )
        )
    columns = [Column("b", "b", "d")]
    for name in ("ours", "sphericart"):
        columns += [Column(f"{name} error", f"{name} error", ".1e"), Column(f"{name} time", f"{name} ms", ".3g", 1e3)]
    return Table(
        "learning_evaluation",
        "Four functions at 2000 directions, and the gradient in the directions, float64, one thread",
        tuple(columns),
        tuple(rows),
        notes=("Errors are differences from the NumPy layer, whose fast transform has 1e-13 itself.",),
    )


def _by_harmonics(peer: Any, coefficients: Any, directions: Any) -> Any:
    return coefficients @ peer(directions).mT


def _memory(b: int) -> Table:
    peak = peak_memory(_MEMORY, b) / 2**30
    columns = (Column("b", "b", "d"), Column("peak", "peak GiB", ".2f"))
    row = Row({"b": b, "peak": peak}, (Check("peak GiB", peak, "<=", _GIB),))
    return Table("learning_memory", "A process that transforms one function forward and backward", columns, (row,))


def _device(bandwidths: tuple[int, ...]) -> Table:
    """Forward and backward on a GPU as a share of its matrix product at the same shapes; correctness comes first."""
    import torch

    from fsh3d_o3d import torch as ft

    columns = (
        Column("b", "b", "d"),
        Column("device", "device"),
        Column("error", "error", ".1e"),
        Column("time", "ms", ".3g", 1e3),
        Column("share", "share of matrix product", ".2f"),
    )
    rows = []
    for b in bandwidths:
        if not torch.cuda.is_available():
            rows.append(Row({"b": b, "device": "not measured: no GPU", "error": None, "time": None, "share": None}))
            continue
        ours = ft.SphericalHarmonicTransform(b, device="cuda", dtype=torch.float32)
        coefficients = torch.randn(64, b * b, device="cuda")
        values = ours.inverse(coefficients)
        error = relative_error(ours(values).cpu(), coefficients.cpu())
        call, made = _differentiated(ours, values), ours._matrices(64)
        part = torch.randn(64, made[0].shape[1], device="cuda") if made else None

        def waiting(inner: Callable[[], Any]) -> None:
            inner()
            torch.cuda.synchronize()

        def products(part: Any = part, made: Any = made) -> None:
            for matrix in made:
                (part @ matrix.mT) @ matrix

        times: dict[str, Timing] = interleave(
            {"ours": partial(waiting, call), "products": partial(waiting, products)}, rounds=7, budget=4.0
        )
        share = times["products"].over(times["ours"]) if made else None
        checks = [Check("error", error, "<=", _ROUND_TRIP["float32"])]
        checks += [Check("share", share, ">=", 0.6)] if share is not None else []
        name = torch.cuda.get_device_name()
        rows.append(Row({"b": b, "device": name, "error": error, "time": times["ours"], "share": share}, tuple(checks)))
    return Table("learning_device", "Forward and backward on a GPU, float32, batch 64", columns, tuple(rows))
