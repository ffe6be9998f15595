"""Fragments, what is seen in each pixel, and how light falls on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d._validation import Float64Array, IntArray
from fsh3d_o3d.report.colors import to_linear, to_srgb

# Directions to the lights in view space, and their strengths. Together with the ambient light a surface that faces the
# key light is just below white.
_KEY = np.array([-0.48, 0.62, 0.62]), 0.82
_FILL = np.array([0.85, 0.05, 0.52]), 0.15
_AMBIENT, _SKY = 0.19, 0.05  # strengths; the second with the height of the normal, as from a sky


@dataclass(frozen=True, eq=False)
class Fragments:
    """What the pixels see; k of them see something."""

    pixel: IntArray
    """(k,) index of the pixel, row-major."""
    normal: Float64Array
    """(k, 3) unit normal in view space, towards the viewer."""
    color: Float64Array
    """(k, 3) sRGB in [0, 1] of the surface."""
    openness: Float64Array
    """(k,) part of the surroundings from which light arrives, in [0, 1]."""


def facing(normal: Float64Array) -> Float64Array:
    """Return normals (k, 3) turned towards the viewer; one that is not finite becomes the viewer's direction."""
    turned = np.where(normal[:, 2:] < 0, -normal, normal)
    turned[~np.isfinite(turned).all(axis=1)] = (0.0, 0.0, 1.0)
    return turned


def picture(fragments: Fragments, width: int, height: int, background: Float64Array | None) -> NDArray[np.uint8]:
    """Return fragments on a raster of twice the size as a picture (height, width, 3), or RGBA without a background.

    Four pixels become one, averaged in linear light.
    """
    light = np.zeros((4 * width * height, 3))
    light[fragments.pixel] = to_linear(fragments.color) * _irradiance(fragments)[:, None]
    seen = np.zeros(4 * width * height)
    seen[fragments.pixel] = 1
    light = _quarter(light.reshape(2 * height, 2 * width, 3))
    coverage = _quarter(seen.reshape(2 * height, 2 * width, 1))
    if background is not None:
        return _bytes(to_srgb(light + (1 - coverage) * to_linear(background)))
    # Straight alpha: the colour of the covered part only.
    color = to_srgb(light / np.maximum(coverage, 0.25))
    return _bytes(np.concatenate((color, coverage), axis=2))


def _irradiance(fragments: Fragments) -> Float64Array:
    normal = fragments.normal
    ambient = _AMBIENT + _SKY * normal[:, 1]
    direct = np.zeros(len(normal))
    for direction, strength in (_KEY, _FILL):
        cosine = normal @ (direction / np.linalg.norm(direction))
        # Wrapped a little around the terminator: a soft, large light.
        direct += strength * np.maximum((cosine + 0.2) / 1.2, 0)
    # What is shut in loses all of the ambient light and, being soft, a part of the direct one.
    return np.asarray(ambient * fragments.openness + direct * (0.45 + 0.55 * fragments.openness))


def _quarter(image: Float64Array) -> Float64Array:
    height, width, channels = image.shape
    blocks = image.reshape(height // 2, 2, width // 2, 2, channels)
    return cast(Float64Array, blocks.mean(axis=(1, 3)))


def _bytes(image: Float64Array) -> NDArray[np.uint8]:
    return np.round(255 * image).astype(np.uint8)
