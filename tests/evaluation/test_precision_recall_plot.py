"""The picture of the curve: where the curve is drawn, and where not."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from fsh3d_o3d.evaluation.precision_recall_plot import precision_recall_png


def blue(precision):
    """Rows and columns of the pixels of the curve."""
    data = precision_recall_png(np.asarray(precision, dtype=np.float64), "a title")
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.format == "PNG"
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert pixels.shape == (640, 640, 3)
    return np.nonzero(pixels[..., 2] - pixels[..., 0] > 100)


@pytest.mark.parametrize("value", [0.25, 0.5, 1.0])
def test_height_is_precision(value):
    rows, columns = blue(np.full(20, value))
    # The frame spans rows 44 (precision 1) to 576 (0) and columns 76 (recall 0) to 616 (1); a marker's radius is 4.
    assert rows.mean() == pytest.approx(576 - value * 532, abs=1)
    assert np.ptp(rows) <= 9
    assert columns.min() == pytest.approx(76 + 0.05 * 540 - 4, abs=1.5)
    assert columns.max() == pytest.approx(616 + 4, abs=1.5)


def test_a_falling_curve_falls():
    rows, columns = blue(np.linspace(1, 0.1, 20))
    assert np.corrcoef(rows, columns)[0, 1] > 0.99


def test_levels_that_are_not_reached_are_left_out():
    columns = blue([0.0] * 10 + [0.5] * 10)[1]
    assert columns.min() == pytest.approx(76 + 0.55 * 540 - 4, abs=1.5)
    assert len(blue(np.zeros(20))[0]) == 0
