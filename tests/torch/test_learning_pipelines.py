"""The worked examples of learning run on small input, say what they say, and draw their pictures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from PIL import Image

from tests.optional import skip_without_torch
from tests.scripts import run_script

LEARNING = Path(__file__).parents[2] / "pipelines" / "learning"


@pytest.fixture(autouse=True)
def _with_torch():
    skip_without_torch()


def width(path):
    """Of a picture, in pixels."""
    with Image.open(path) as picture:
        return picture.size[0]


def test_fit_depth(tmp_path):
    done = run_script(LEARNING / "fit_depth.py", "--output", tmp_path, "--steps", "120")
    assert done.returncode == 0, done.stderr
    error = dict(re.findall(r"^(\w[\w ]+?) +RMSE +([\d.]+) %", done.stdout, flags=re.MULTILINE))
    # A robust loss gives up on wrong pixels, and squares do not: 0.25 % and 0.59 % after all the steps.
    assert float(error["gradient descent"]) < 0.7 * float(error["least squares"])
    assert width(tmp_path / "fit_depth.png") > 900


def test_classify_shapes(tmp_path):
    done = run_script(LEARNING / "classify_shapes.py", "--output", tmp_path, "--steps", "3")
    assert done.returncode == 0, done.stderr
    rate = dict(re.findall(r"^(\w[\w .,()]+?) +([\d.]+) % ±", done.stdout, flags=re.MULTILINE))
    assert set(rate) == {"SHDOption.best()", "as they lie", "learned, invariant", "learned, not invariant"}
    # Four stretched samples are easy for what does not notice poses, and less so for what does.
    assert min(float(rate["SHDOption.best()"]), float(rate["learned, invariant"])) >= 90
    assert float(rate["as they lie"]) < 90
    assert width(tmp_path / "classify_shapes.png") > 500
