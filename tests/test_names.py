"""What the documents name can be imported: from the package, or by the dotted name that is given."""

from __future__ import annotations

import ast
import functools
import importlib
import re
from pathlib import Path

import pytest

import fsh3d_o3d as fsh
from tests.optional import HAS_TORCH

PACKAGE = Path(fsh.__file__).parent
ROOT = PACKAGE.parent
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")])
WORDS = {"bandwidth", "degree", "describe", "open3d", "rotation"}
"""Arguments, methods and modules that are called like a function inside of the package."""


@functools.cache
def defined():
    """Names of all functions and classes at the top of the package's files."""
    own = (path for path in PACKAGE.rglob("*.py") if path.parent.name != "torch")  # their names stand after ``ft.``
    nodes = (node for path in own for node in ast.parse(path.read_text("utf-8")).body)
    named = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return {name for name in named if not name.startswith("_")} - WORDS


def in_code_font(text):
    """The dotted name at the start of each piece of code between single backticks, and the names after a fsh."""
    blocks = re.findall(r"```.*?```", text, flags=re.DOTALL)
    rest = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    starts = (re.match(r"[A-Za-z_][\w.]*", code) for code in re.findall(r"`([^`\n]+)`", rest))
    yield from (start.group().rstrip(".") for start in starts if start)
    for block in blocks:
        yield from re.findall(r"\b(?:fsh|ft)\.\w+", block)


def exists(name):
    """Whether a dotted name leads somewhere from the package: an attribute, a field, or a folder's name."""
    value = fsh
    if name.startswith("ft."):
        value, name = importlib.import_module("fsh3d_o3d.torch"), name.removeprefix("ft.")
    for part in name.split("."):
        fields = getattr(value, "__dataclass_fields__", {})
        if part in fields and not hasattr(value, part):
            return True  # of an instance
        if not hasattr(value, part):
            return False
        value = getattr(value, part)
    return True


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_names_in_code_font_can_be_imported(page):
    wrong = set()
    for written in in_code_font(page.read_text("utf-8")):
        name = re.sub(r"^(fsh|fsh3d_o3d)\.", "", written)
        first = name.partition(".")[0]
        if first == "torch" and (name == written or not HAS_TORCH):
            continue  # PyTorch's own; ours stand after ``ft.``
        if first == "ft":
            if HAS_TORCH and not exists(name):
                wrong.add(written)
            continue
        ours = name != written or first in defined() or (first in fsh.__all__ and "." in name)
        if first == "index":
            name = name.replace("index.", "ShapeIndex.", 1)  # one of them, not the folder
            first = "ShapeIndex"
        folder = (PACKAGE / first / "__init__.py").exists() and "." in name and not name.endswith(".py")
        if folder:
            importlib.import_module(f"fsh3d_o3d.{first}")
        if ((ours or folder) and not exists(name)) or (
            ours and not folder and first not in fsh.__all__ and not (PACKAGE / first).exists()
        ):
            wrong.add(written)
    assert sorted(wrong) == []


def test_what_results_hold_is_public():
    """Classes of ours in the annotations of public values."""
    missing = set()
    for name in fsh.__all__:
        for field in getattr(getattr(fsh, name), "__dataclass_fields__", {}).values():
            missing |= {word for word in re.findall(r"[A-Z]\w+", str(field.type)) if word in defined()}
    assert sorted(missing - set(fsh.__all__)) == []
