"""Every public function and class shows how it is used, and what it shows runs."""

from __future__ import annotations

import dataclasses
import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import fsh3d_o3d as fsh

SAMPLES = Path(__file__).parents[1] / "samples"
PUBLIC = {name: getattr(fsh, name) for name in fsh.__all__ if callable(getattr(fsh, name))}


def examples(name: str) -> list[doctest.DocTest]:
    """What docstrings of a function, or of a class, its methods and those of its bases show, as they stand."""
    found: list[doctest.DocTest] = []
    for value in family(PUBLIC[name]) if inspect.isclass(PUBLIC[name]) else [PUBLIC[name]]:
        tests = doctest.DocTestFinder().find(value, name, module=False, globs={})
        found += sorted((test for test in tests if test.examples), key=lambda test: test.lineno or 0)
    return found


def family(value: type) -> list[type]:
    """A class and its bases in this package."""
    return [base for base in value.__mro__ if base.__module__.startswith("fsh3d_o3d")]


def shown(name: str) -> str:
    """The code of these examples."""
    return "".join(example.source for test in examples(name) for example in test.examples)


def methods(value: object) -> list[str]:
    """Names of the public methods of a class."""
    bases = family(value) if inspect.isclass(value) else []
    return [
        name
        for base in bases
        for name, member in vars(base).items()
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, (classmethod, staticmethod)))
    ]


def is_result(value: object) -> bool:
    """Whether this is a value that functions return and nobody makes: frozen, with fields that have to be given."""
    if not dataclasses.is_dataclass(value) or any(isinstance(member, classmethod) for member in vars(value).values()):
        return False
    missing = (dataclasses.MISSING, dataclasses.MISSING)
    return any((field.default, field.default_factory) == missing for field in dataclasses.fields(value))


def is_exempt(value: object) -> bool:
    """Whether this is nothing to call: an error that is caught, or a protocol, which others follow."""
    return inspect.isclass(value) and (issubclass(value, Exception) or getattr(value, "_is_protocol", False))


def returned(value: object) -> str:
    """What a function or the methods of a class return, or what the fields of a result hold, as it is written."""
    if is_result(value):
        return " ".join(str(field.type) for field in dataclasses.fields(value))
    functions = [getattr(value, name) for name in methods(value)] if inspect.isclass(value) else [value]
    return " ".join(str(inspect.signature(function).return_annotation) for function in functions)


@pytest.mark.parametrize("name", [name for name in PUBLIC if not is_exempt(PUBLIC[name])])
def test_every_public_name_shows_its_use(name):
    value = PUBLIC[name]
    everything = "".join(map(shown, PUBLIC))
    if is_result(value):
        makers = [other for other in PUBLIC if other != name and re.search(rf"\b{name}\b", returned(PUBLIC[other]))]
        made = re.search(rf"\bfsh\.{name}\(", shown(name))  # by hand, in its own example
        assert makers or made, f"{name}: nothing public returns it; show how it is made"
    else:
        assert re.search(rf"\bfsh\.{name}\b", shown(name)), f"{name}: its docstring has no example of it"
    for method in methods(value):
        code = everything if is_result(value) else shown(name)
        assert re.search(rf"\.{method}\(", code), f"{name}.{method}: no example calls it"


@pytest.mark.parametrize("name", [name for name in PUBLIC if examples(name)])
def test_example_runs(name, tmp_path, monkeypatch):
    """Methods go on where their class's example ends."""
    (tmp_path / "samples").symlink_to(SAMPLES)
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    names, report = {"fsh": fsh, "np": np}, []
    for test in examples(name):
        assert not any(doctest.SKIP in example.options for example in test.examples), "an example that never runs"
        assert "Example:\n" in test.docstring, "an example that the reference does not show as one"
        test.globs = names
        runner.run(test, out=report.append, clear_globs=False)
    assert not report, "".join(report)


def test_example_of_the_package_runs():
    found = doctest.DocTestParser().get_doctest(fsh.__doc__, {}, "fsh3d_o3d", None, None)
    assert found.examples
    assert doctest.DocTestRunner().run(found).failed == 0
