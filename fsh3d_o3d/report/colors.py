"""Colours: sRGB in and out of linear light, and the ramp for errors."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from fsh3d_o3d._validation import Float64Array, number, real_array

ORIGINAL_COLOR = (0.79, 0.76, 0.70)
"""sRGB of an original surface."""
RECONSTRUCTION_COLOR = (0.61, 0.73, 0.84)
"""sRGB of a reconstructed surface."""
NO_VALUE_COLOR = (0.55, 0.55, 0.55)
"""sRGB where an error is not known (NaN)."""

# OKLCH control points: lightness, chroma, hue in degrees. Lightness falls steadily, so that the order of errors
# survives greyscale and colour blindness; the light end is the plain surface, so that a good reconstruction looks calm.
_CONTROL_POINTS = np.array(
    [
        [0.955, 0.025, 105.0],
        [0.860, 0.110, 85.0],
        [0.745, 0.155, 58.0],
        [0.620, 0.190, 32.0],
        [0.480, 0.175, 5.0],
        [0.340, 0.120, -30.0],
    ]
)
_STEPS = 256  # of the ramp: one for each value of an 8-bit channel

# OKLab (B. Ottosson, 2020): cube roots of cone responses to Lab and cone responses to linear sRGB.
_LAB_TO_CONES = np.array(
    [[1.0, 0.3963377774, 0.2158037573], [1.0, -0.1055613458, -0.0638541728], [1.0, -0.0894841775, -1.2914855480]]
)
_CONES_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def error_colors(values: Any, maximum: float | None = None) -> Float64Array:
    """Return sRGB colours (v, 3) in [0, 1] for errors (v,): pale for none, over orange to dark purple for ``maximum``.

    Lightness falls evenly with the error. Errors above the maximum take its colour; NaN is grey.

    Args:
        values: (v,) errors, not negative; NaN where there is none, infinite allowed.
        maximum: Error at the dark end, > 0; by default the largest finite one.

    Raises:
        TypeError: Not real numbers.
        ValueError: Wrong shape, negative errors, a maximum that is not positive.
    """
    errors = real_array(values, "values", finite=False)
    if errors.ndim != 1:
        raise ValueError(f"values must have shape (v,), got {errors.shape}")
    if (errors < 0).any():
        raise ValueError(f"values must be errors >= 0, but the least is {np.nanmin(errors):g}")
    if maximum is None:
        top = float(errors[np.isfinite(errors)].max(initial=0.0)) or 1.0
    else:
        top = number(maximum, "maximum", minimum=0, exclusive=True)
    known = ~np.isnan(errors)
    position = np.minimum(np.where(known, errors, 0.0), top) / top * (_STEPS - 1)
    table = _ramp(np.linspace(0, 1, _STEPS))
    colors = np.stack([np.interp(position, np.arange(_STEPS), column) for column in table.T], axis=1)
    colors[~known] = NO_VALUE_COLOR
    return colors


def color_stops(count: int = 17) -> list[tuple[float, str]]:
    """Return the ramp as ``count`` pairs of position in [0, 1] and ``#rrggbb``."""
    positions = np.linspace(0, 1, count)
    rgb = np.round(255 * _ramp(positions)).astype(int)
    return [(float(p), css_color(color / 255)) for p, color in zip(positions, rgb, strict=True)]


def css_color(color: Any) -> str:
    """Return an sRGB colour in [0, 1] as ``#rrggbb``."""
    return "#" + "".join(f"{round(255 * float(channel)):02x}" for channel in color)


def to_linear(srgb: Any) -> Float64Array:
    """Return sRGB in [0, 1] as linear light (IEC 61966-2-1)."""
    value = np.clip(np.asarray(srgb, dtype=np.float64), 0, 1)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Any) -> Float64Array:
    """Return linear light as sRGB, clipped to [0, 1]."""
    value = np.clip(np.asarray(linear, dtype=np.float64), 0, 1)
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)


def _ramp(positions: Float64Array) -> Float64Array:
    knots = np.linspace(0, 1, len(_CONTROL_POINTS))
    lightness, chroma, hue = (np.interp(positions, knots, column) for column in _CONTROL_POINTS.T)
    angle = np.radians(hue)
    lab = np.stack((lightness, chroma * np.cos(angle), chroma * np.sin(angle)), axis=-1)
    return to_srgb(cast(Float64Array, (lab @ _LAB_TO_CONES.T) ** 3 @ _CONES_TO_RGB.T))
