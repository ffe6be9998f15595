"""The spherical harmonic transform on a grid as a module: plan once, transform and differentiate many times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from fsh3d_o3d import _validation as check
from fsh3d_o3d.sphere import SphericalGrid, WeightSolution, solve_weights, warn_if_inexact
from fsh3d_o3d.sphere import SphericalHarmonicTransform as Plan
from fsh3d_o3d.torch import checks, dense
from fsh3d_o3d.torch.precision import full_precision
from fsh3d_o3d.torch.sums import analyse, synthesise

__all__ = ["SphericalHarmonicTransform"]

Engine = Literal["auto", "dense", "sums"]

_SMALLEST_DENSE_BATCH = {24: 1, 32: 8, 40: 24}  # functions, by bandwidth up to which so many suffice; as in NumPy
_CPU_BYTES = 2**29  # of the matrices on the CPU, a choice: the fast transform needs none
_DEVICE_BYTES = 2**33  # on a device, a choice: bandwidth 128 in float64, a tenth of what large ones have


class SphericalHarmonicTransform(nn.Module):
    """A plan for transforms between n samples on a grid and the b² coefficients of degree < b, with gradients.

    ``forward`` is quadrature, f̂ = Σ_j w_j f(ω_j) Y(ω_j), exact for functions of degree < b where the weights are;
    ``inverse`` is synthesis. Both are linear, so that each one's gradient is the other but for the weights. Nothing
    learns: the state dict holds ``weights`` and ``directions``, to tell whether a state is of this grid. Changing
    precision or device makes the matrices anew, so that ``.float().double()`` loses nothing.

    Args:
        bandwidth: b; degrees 0 … b − 1.
        grid: Where functions are sampled; the Fibonacci grid of 6b² points if not given.
        weights: (n,) quadrature weights summing to 4π, an array, a tensor or a ``WeightSolution``; the analytic
            weights if not given.
        engine: ``"dense"``: matrices, halved on Fibonacci grids. ``"sums"``: ducc0's fast transform on the CPU, a
            recursion over degrees elsewhere; neither holds a matrix. ``"auto"``: what is faster for the device,
            the bandwidth and the batch.
        device: Where it computes; PyTorch's default if not given.
        dtype: float32 or float64; PyTorch's default if not given.

    Raises:
        TypeError, ValueError: An argument is of the wrong type, out of range, or of the wrong shape; weights that
            require gradients.
        MemoryEstimateError: The transform would not fit in memory.

    Warns:
        QuadratureWarning: There are no exact weights for the grid.

    Example:
        >>> transform = ft.SphericalHarmonicTransform(bandwidth=8, dtype=torch.float64)
        >>> coefficients = torch.rand(5, 64, dtype=torch.float64, requires_grad=True)
        >>> values = transform.inverse(coefficients)
        >>> values.shape
        torch.Size([5, 384])
        >>> torch.allclose(transform(values), coefficients)
        True
        >>> values.square().sum().backward()
        >>> coefficients.grad.shape
        torch.Size([5, 64])
    """

    weights: Tensor
    """(n,) quadrature weights."""
    directions: Tensor
    """(n, 3) unit vectors."""

    def __init__(
        self,
        bandwidth: int,
        grid: SphericalGrid | None = None,
        weights: object | None = None,
        *,
        engine: Engine = "auto",
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> None:
        super().__init__()
        self.engine = check.choice(engine, "engine", ("auto", "dense", "sums"))
        dtype = torch.get_default_dtype() if dtype is None else dtype
        if dtype not in checks.PRECISIONS:
            raise TypeError(f"dtype must be torch.float32 or torch.float64, got {dtype}")
        if isinstance(weights, Tensor):
            _refuse_gradients(weights)
            weights = weights.detach().cpu().numpy()
        b = check.bandwidth(bandwidth)
        given = Plan(b, grid, np.full(6 * b * b if grid is None else len(grid), 1.0) if weights is None else weights)
        solution: WeightSolution | object = weights
        if weights is None:
            solution = solve_weights(given.grid, b)
            warn_if_inexact(solution, given.grid, stacklevel=3)
        self.plan = Plan(b, given.grid, solution)
        """The same in NumPy: its grid and its weights in float64."""
        device = torch.get_default_device() if device is None else torch.device(device)
        for name, array in (("weights", self.plan.weights), ("directions", self.plan.grid.directions)):
            self.register_buffer(name, torch.tensor(array, dtype=dtype, device=device))
        halved = len(self.plan.grid) > 1 and self.plan.grid.half_turn_symmetric
        self._halved = bool(halved)
        order = torch.argsort(dense.parities(b), stable=True)
        self.register_buffer("_order", order.to(device), persistent=False)
        self.register_buffer("_place", torch.argsort(order).to(device), persistent=False)
        for name in ("_even", "_odd"):
            self.register_buffer(name, None, persistent=False)
        self._prepare()

    @property
    def bandwidth(self) -> int:
        """b: degrees 0 … b − 1."""
        return self.plan.bandwidth

    @property
    def grid(self) -> SphericalGrid:
        """Where functions are sampled."""
        return self.plan.grid

    @full_precision
    def forward(self, values: Tensor) -> Tensor:
        """Return the coefficients of sampled functions: (…, n) → (…, b²).

        Raises:
            TypeError: Not a tensor of the transform's precision.
            ValueError: Wrong last axis, another device, values that are not finite, a buffer that requires gradients.

        Example:
            >>> transform.forward(torch.ones(384, dtype=torch.float64))[0] ** 2  # 4π
            tensor(12.5664, dtype=torch.float64)
        """
        samples = checks.real(values, "values")
        checks.last_axis(samples, "values", len(self.weights), "n")
        self._check(samples, "values")
        flat = (samples * self.weights).reshape(-1, len(self.weights))
        made = self._matrices(len(flat))
        if made:
            result = dense.analyse(flat, self._order, self._place, list(made))
        else:
            result = analyse(flat[None], self.directions[None], self.bandwidth)[0]
        return result.reshape(*samples.shape[:-1], self.bandwidth**2)

    @full_precision
    def inverse(self, coefficients: Tensor) -> Tensor:
        """Return the functions of given coefficients at the grid's points: (…, b²) → (…, n).

        Fewer coefficients than b² are a function of smaller bandwidth.

        Raises:
            TypeError: Not a tensor of the transform's precision.
            ValueError: The last axis is not a square number or more than b², another device, values that are not
                finite, a buffer that requires gradients.

        Example:
            >>> transform.inverse(torch.ones(1, dtype=torch.float64))[0]  # the harmonic of degree 0, 1/√4π
            tensor(0.2821, dtype=torch.float64)
        """
        given, b = checks.coefficients(coefficients)
        if b > self.bandwidth:
            raise ValueError(
                f"coefficients are of bandwidth {b}, the transform of {self.bandwidth}; take the first "
                f"{self.bandwidth}² = {self.bandwidth**2} of the last axis"
            )
        self._check(given, "coefficients")
        flat = given.reshape(-1, b * b)
        made = self._matrices(len(flat))
        if made:
            padded = nn.functional.pad(flat, (0, self.bandwidth**2 - b * b))
            result = dense.synthesise(padded, len(self.weights), self._order, self._place, list(made))
        else:
            result = synthesise(flat[None], self.directions[None])[0]
        return result.reshape(*given.shape[:-1], len(self.weights))

    def extra_repr(self) -> str:
        """What ``print`` shows of it.

        Example:
            >>> transform
            SphericalHarmonicTransform(bandwidth=8, grid=fibonacci of 384, engine=auto)
        """
        return f"bandwidth={self.bandwidth}, grid={self.grid.name} of {len(self.grid)}, engine={self.engine}"

    def _check(self, value: Tensor, name: str) -> None:
        _refuse_gradients(self.weights)
        checks.alike(value, name, self.weights, "the transform's buffers")

    def _matrices(self, batch: int) -> tuple[Tensor, ...]:
        """The matrices where they are the better way for so many functions."""
        if self._even is None:
            return ()
        if self.engine == "auto" and self._even.device.type == "cpu":
            small = any(self.bandwidth <= limit and batch >= least for limit, least in _SMALLEST_DENSE_BATCH.items())
            if not small:
                return ()
        return (self._even,) if self._odd is None else (self._even, self._odd)

    def _prepare(self) -> None:
        """Make the matrices for the precision and the device, if they are ever used there."""
        b, n, device, dtype = self.bandwidth, len(self.grid), self.weights.device, self.weights.dtype
        size = b * b * (n // (2 if self._halved else 1)) * dtype.itemsize
        on_cpu = device.type == "cpu"
        self._even = self._odd = None
        if self.engine == "sums":
            return
        if self.engine == "auto" and (
            size > (_CPU_BYTES if on_cpu else _DEVICE_BYTES) or (on_cpu and b > max(_SMALLEST_DENSE_BATCH))
        ):
            return
        if on_cpu:
            check.memory(1.1 * size, f"the dense transform of bandwidth {b} on {n} points")
        points = torch.tensor(self.grid.directions, device=device)
        made = dense.matrices(points, b, halved=self._halved, dtype=dtype)
        self._even, self._odd = (*made, None)[:2]

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> SphericalHarmonicTransform:
        """Called by ``.to`` and all of its kind."""
        before, made = self.weights, (self._even, self._odd)
        self._even = self._odd = None
        super()._apply(fn, recurse)
        if self.weights.dtype not in checks.PRECISIONS:
            dtype, (self.weights, self.directions) = self.weights.dtype, (before, self.directions.to(before.dtype))
            self._even, self._odd = made
            raise TypeError(f"a transform computes in float32 or float64, not {dtype}: half precision has 3 digits")
        if (self.weights.dtype, self.weights.device) == (before.dtype, before.device):
            self._even, self._odd = made
            return self
        if before.device.type != "meta" and self.weights.device.type != "meta":
            own = torch.tensor(self.plan.weights, dtype=before.dtype, device=before.device)
            if self.weights.dtype != before.dtype and torch.equal(own, before):  # not those of a state that was loaded
                self.weights = torch.tensor(self.plan.weights, dtype=self.weights.dtype, device=self.weights.device)
            self.directions = torch.tensor(self.grid.directions, dtype=self.weights.dtype, device=self.weights.device)
        self._prepare()
        return self

    def _load_from_state_dict(
        self, state_dict: Mapping[str, Any], prefix: str, metadata: Any, strict: bool, missing: Any, unexpected: Any,
        errors: list[str],
    ) -> None:  # fmt: skip
        """Refuse the state of another grid, whose weights would go with points that are not its own."""
        theirs = state_dict.get(f"{prefix}directions")
        if isinstance(theirs, Tensor) and theirs.device.type != "meta":
            own = torch.tensor(self.grid.directions)
            if theirs.shape != own.shape or not torch.allclose(theirs.detach().cpu().double(), own, atol=1e-6, rtol=0):
                errors.append(
                    f"the state of {prefix or 'the transform'} is of another grid, of {len(theirs)} points where this "
                    f"one has {len(own)}: make the transform with the grid that it was saved with"
                )
                return
        super()._load_from_state_dict(state_dict, prefix, metadata, strict, missing, unexpected, errors)


def _refuse_gradients(weights: Tensor) -> None:
    if weights.requires_grad:
        raise ValueError("weights of a transform do not learn, but they require gradients: give weights.detach()")
