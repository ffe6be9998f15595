"""The precision–recall curve as a picture."""

from __future__ import annotations

import io

from fsh3d_o3d._imports import only_installed
from fsh3d_o3d._validation import Float64Array
from fsh3d_o3d.evaluation.metrics import RECALL_LEVELS

with only_installed():  # loaded late
    from PIL import Image, ImageDraw, ImageFont

_SIZE = 640  # pixels of a side
_SCALE = 3  # times larger when drawn, then reduced: Pillow's lines have no smooth edges
_LEFT, _TOP, _RIGHT, _BOTTOM = 76, 44, 616, 576  # pixels, of the axes; the rest is for labels
_INK, _PALE, _CURVE = (32, 32, 32), (222, 222, 222), (0, 90, 160)  # sRGB of text, lines, curve


def precision_recall_png(precision: Float64Array, title: str) -> bytes:
    """Return a PNG picture of the precision (20,) at ``RECALL_LEVELS``; levels that no query reaches (0) are left out.

    Args:
        precision: As in ``RetrievalMetrics.precision_recall``.
        title: One short line above the curve.
    """
    picture = Image.new("RGB", (_SIZE * _SCALE, _SIZE * _SCALE), "white")
    draw = ImageDraw.Draw(picture)
    text = ImageFont.load_default(size=16 * _SCALE)
    for tick in range(0, 11, 2):
        label = f"{tick / 10:.1f}"
        draw.line([_at(tick / 10, 0), _at(tick / 10, 1)], fill=_PALE, width=_SCALE)
        draw.line([_at(0, tick / 10), _at(1, tick / 10)], fill=_PALE, width=_SCALE)
        draw.text(_moved(_at(tick / 10, 0), 0, 8), label, fill=_INK, font=text, anchor="mt")
        draw.text(_moved(_at(0, tick / 10), -8, 0), label, fill=_INK, font=text, anchor="rm")
    draw.rectangle([_at(0, 1), _at(1, 0)], outline=_INK, width=_SCALE)
    draw.text(_moved(_at(0.5, 1), 0, -12), title, fill=_INK, font=text, anchor="mb")
    draw.text(_moved(_at(0.5, 0), 0, 32), "recall", fill=_INK, font=text, anchor="mt")
    _upright(picture, "precision", text, (20 * _SCALE, _at(0, 0.5)[1]))
    points = [_at(r, p) for r, p in zip(RECALL_LEVELS.tolist(), precision.tolist(), strict=True) if p > 0]
    if points:
        draw.line(points, fill=_CURVE, width=2 * _SCALE, joint="curve")
    for x, y in points:
        draw.ellipse([x - 4 * _SCALE, y - 4 * _SCALE, x + 4 * _SCALE, y + 4 * _SCALE], fill=_CURVE)
    stream = io.BytesIO()
    picture.resize((_SIZE, _SIZE), Image.Resampling.LANCZOS).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _at(recall: float, precision: float) -> tuple[float, float]:
    return _SCALE * (_LEFT + recall * (_RIGHT - _LEFT)), _SCALE * (_BOTTOM - precision * (_BOTTOM - _TOP))


def _moved(point: tuple[float, float], right: float, down: float) -> tuple[float, float]:
    return point[0] + _SCALE * right, point[1] + _SCALE * down


def _upright(
    picture: Image.Image,
    label: str,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    center: tuple[float, float],
) -> None:
    """Write a label that reads from the bottom up."""
    box = font.getbbox(label)
    lying = Image.new("L", (int(box[2]) + 1, int(box[3]) + 1), 0)
    ImageDraw.Draw(lying).text((0, 0), label, fill=255, font=font)
    mask = lying.rotate(90, expand=True)
    picture.paste(_INK, (int(center[0] - mask.width / 2), int(center[1] - mask.height / 2)), mask)
