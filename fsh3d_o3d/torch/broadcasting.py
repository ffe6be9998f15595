"""Functions that come in groups, each with directions or a rotation of its own."""

from __future__ import annotations

import torch
from torch import Tensor


def grouped(coefficients: Tensor, own: Tensor, trailing: int, name: str) -> tuple[torch.Size, Tensor, Tensor]:
    """Broadcast (…, b²) with what belongs to groups of functions, (…, *) with so many trailing axes.

    Returns:
        The leading axes, functions (d, k, b²), and (d or 1, *): axes along which all functions share one stay together.

    Raises:
        ValueError: The leading axes do not fit.
    """
    mine = own.shape[:-trailing]
    try:
        leading = torch.broadcast_shapes(coefficients.shape[:-1], mine)
    except RuntimeError:
        raise ValueError(
            f"the leading axes of {name} {tuple(own.shape)} do not fit those of coefficients "
            f"{tuple(coefficients.shape)}"
        ) from None
    padded = (1,) * (len(leading) - len(mine)) + tuple(mine)
    shared = next((k for k in range(len(padded)) if all(size == 1 for size in padded[k:])), len(padded))
    groups, rest = leading[:shared].numel(), leading[shared:].numel()
    # Counted rather than left to be inferred, for which there is no telling where a batch is empty.
    functions = coefficients.expand(*leading, -1).reshape(groups, rest, coefficients.shape[-1])
    places = own.reshape(*padded[:shared], *own.shape[-trailing:]).expand(*leading[:shared], *own.shape[-trailing:])
    return leading, functions, places.reshape(groups, *own.shape[-trailing:])
