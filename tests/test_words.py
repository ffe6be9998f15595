"""What the source says of itself holds: names in docstrings exist, and numeric constants say unit and reason."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import fsh3d_o3d

PACKAGE = Path(fsh3d_o3d.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def _name(path):
    return path.relative_to(PACKAGE).as_posix()


def _docstrings(tree):
    """The string statements of a file: docstrings, and those below constants and fields."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]


@pytest.fixture(scope="module")
def words():
    """All names in the code of the package and the files in it, without docstrings and comments."""
    found = set()
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for statement in _docstrings(tree):
            statement.value = ast.Constant(value=0)
        found |= {path.stem, path.parent.name} | set(re.findall(r"\w+", ast.unparse(tree)))
    return found


@pytest.mark.parametrize("path", SOURCES, ids=_name)
def test_private_names_and_files_in_docstrings_exist(path, words):
    for statement in _docstrings(ast.parse(path.read_text(encoding="utf-8"))):
        text = str(statement.value.value)
        for name in re.findall(r"``(_\w+)``", text):
            assert name in words, name
        for name in re.findall(r"``((?:[a-z_]+/)+[a-z_]+\.(?:py|md))``", text):
            assert (PACKAGE / name).exists() or (PACKAGE.parent / name).exists(), name
        assert "(private" not in text, "what is private is what a door does not export"


def _is_numeric(value):
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float)) and not isinstance(value.value, bool)
    if isinstance(value, ast.UnaryOp):
        return _is_numeric(value.operand)
    if isinstance(value, ast.BinOp):
        return _is_numeric(value.left) or _is_numeric(value.right)
    return isinstance(value, ast.Tuple) and bool(value.elts) and all(map(_is_numeric, value.elts))


@pytest.mark.parametrize("path", SOURCES, ids=_name)
def test_numeric_constants_say_what_they_count_and_why(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    body = ast.parse("\n".join(lines)).body
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, (ast.Assign, ast.AnnAssign)) and statement.value is not None:
            target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
            name = ast.unparse(target)
            if name != name.upper() or not _is_numeric(statement.value):
                continue
            described = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            own = lines[statement.lineno - 1 : statement.end_lineno]
            above = lines[statement.lineno - 2].startswith("# ")
            assert described or above or any("# " in line for line in own), f"{name}: unit and reason are missing"
