"""Finished pictures: into PNG files, and beside each other with captions."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsh3d_o3d import _validation as check
from fsh3d_o3d._imports import only_installed

with only_installed():  # loaded late
    from PIL import Image, ImageDraw, ImageFont

_SMALLEST = 13  # pixels of a caption's letters
_GAP = 12  # pixels between pictures and around captions
_TEXT_COLOR = (40, 40, 40)  # sRGB of captions, nearly black
_ELLIPSIS = "..."  # the built-in font need not have the one-character form


def encode_png(image: Any) -> bytes:
    """Return an image (h, w, 3 or 4) uint8 as a PNG file; the same image gives the same bytes.

    Raises:
        TypeError: Not uint8.
        ValueError: Another shape.
    """
    file = io.BytesIO()
    Image.fromarray(_checked(image, "image")).save(file, format="PNG", compress_level=6)
    return file.getvalue()


def side_by_side(images: Sequence[Any], labels: Sequence[str]) -> NDArray[np.uint8]:
    """Return pictures in a row on white, each above its caption, as one (h, w, 3) uint8.

    Pictures of different height are centred. A caption is one line in Pillow's own font; one that is wider than its
    picture is cut.

    Args:
        images: At least one (h, w, 3 or 4) uint8.
        labels: As many captions.

    Raises:
        TypeError: An image that is not uint8.
        ValueError: No images, another shape, or not one label for each image.
    """
    if not images or len(images) != len(labels):
        raise ValueError(f"side_by_side needs one label for each image, got {len(images)} and {len(labels)}")
    pictures = [Image.fromarray(_checked(image, f"images[{i}]")) for i, image in enumerate(images)]
    tallest = max(picture.height for picture in pictures)
    size = max(_SMALLEST, tallest // 22)
    # Laid out by Pillow alone: the same everywhere, and words apart in small captions.
    font: Any = ImageFont.load_default(size)
    font = font.font_variant(layout_engine=ImageFont.Layout.BASIC)
    width = sum(picture.width for picture in pictures) + _GAP * (len(pictures) - 1)
    strip = Image.new("RGB", (width, tallest + size + 2 * _GAP), "white")
    draw = ImageDraw.Draw(strip)
    left = 0
    for picture, label in zip(pictures, labels, strict=True):
        place = (left, (tallest - picture.height) // 2)
        strip.paste(picture, place, picture if picture.mode == "RGBA" else None)
        text = _fitted(" ".join(label.split()), font, picture.width)
        draw.text((left + picture.width / 2, tallest + _GAP), text, _TEXT_COLOR, font, anchor="ma")
        left += picture.width + _GAP
    return np.array(strip)


def _fitted(text: str, font: Any, width: int) -> str:
    if font.getlength(text) <= width:
        return text
    while text and font.getlength(text + _ELLIPSIS) > width:
        text = text[:-1]
    return text + _ELLIPSIS


def _checked(image: Any, name: str) -> NDArray[np.uint8]:
    array = np.asarray(check.unmasked(image, name))
    if array.dtype != np.uint8:
        raise TypeError(f"{name} must be uint8, got {array.dtype}")
    if array.ndim != 3 or array.shape[2] not in (3, 4) or 0 in array.shape:
        raise ValueError(f"{name} must have shape (h, w, 3) or (h, w, 4), got {array.shape}")
    return np.ascontiguousarray(array)
