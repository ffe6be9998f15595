"""constraints.txt: what the script that writes it makes of pip's answers, and that it names what is needed."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def constraints():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "tools"))
        import constraints

        yield constraints
    sys.modules.pop("constraints")


def test_one_line_for_each_version_and_the_pythons_it_is_for(constraints):
    versions = {
        "same": ["1", "1", "1", "1"],
        "only-old": ["2", None, None, None],
        "cut": ["1", "2", "2", "2"],
        "late": ["1", "1", "1", "2"],
        "middle": ["1", "2", "2", "3"],
        "gap": ["1", None, "1", "2"],
    }
    pythons = ["3.10", "3.11", "3.12", "3.13"]
    resolved = {python: {name: row[k] for name, row in versions.items() if row[k]} for k, python in enumerate(pythons)}
    assert constraints.lines(resolved) == [
        'cut==1; python_version == "3.10"',
        'cut==2; python_version >= "3.11"',
        'gap==1; python_version == "3.10"',
        'gap==1; python_version == "3.12"',
        'gap==2; python_version == "3.13"',
        'late==1; python_version < "3.13"',
        'late==2; python_version == "3.13"',
        'middle==1; python_version == "3.10"',
        'middle==2; python_version >= "3.11" and python_version < "3.13"',
        'middle==3; python_version == "3.13"',
        "only-old==2",
        "same==1",
    ]


def test_everything_the_package_asks_for_has_a_version(constraints):
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    wanted = re.findall(
        r'"([A-Za-z0-9._-]+)>=[0-9.]+"', text.partition("\ndependencies = [")[2].partition("[project.scripts]")[0]
    )
    assert len(wanted) > 30
    assert {"cpu", "cuda", "bench", "ray", "docs", "dev"} <= set(constraints.extras())
    listed = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    names = {line.partition("==")[0] for line in listed if not line.startswith("#")}
    assert {re.sub(r"[-_.]+", "-", name).lower() for name in wanted} <= names


def test_names_and_versions_only():
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        assert line.startswith("#") or re.fullmatch(
            r"[a-z0-9-]+==[0-9a-z.!+]+(; python_version [<>=]+ \"3\.\d+\"( and .*)?)?", line
        )
