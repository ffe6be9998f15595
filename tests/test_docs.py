"""The documentation site builds without warnings, holds every public name, and loads nothing from elsewhere."""

from __future__ import annotations

import pkgutil
import re
import shutil
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest

import fsh3d_o3d as fsh
from tests.optional import HAS_TORCH

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site. Pages of the reference are written beside the others, so that it is built from a copy."""
    root = tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "docs", root / "docs", ignore=shutil.ignore_patterns("reference"))
    for linked in ("pipelines", "samples", "tools"):
        (root / linked).symlink_to(ROOT / linked)
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", str(root / "docs"), str(root / "site")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()
    return root / "site"


def test_every_public_name_is_in_the_reference(site):
    pages = {path.stem: path.read_text(encoding="utf-8") for path in (site / "reference").glob("*.html")}
    overview = pages.pop("index")
    assert f"version {fsh.__version__}" in overview
    documented = [name for page in pages.values() for name in re.findall(r'id="fsh3d_o3d\.(\w+)"', page)]
    # Each once, and nothing that is not public.
    assert sorted(documented) == sorted(set(fsh.__all__) - {"__version__"})
    assert all(f'href="{name}"' in overview for name in (f"{page}.html" for page in pages))
    assert all(f"#fsh3d_o3d.{name}" in overview for name in documented)


def test_docstrings_are_understood(site):
    page = (site / "reference" / "shapes.html").read_text(encoding="utf-8")
    assert 'class="sig-name descname"><span class="pre">coefficients' in page  # a field, documented where it stands
    assert "Parameters" in page and "Raises" in page and "Example" in page  # the sections of Google style
    assert 'class="gp">&gt;&gt;&gt;' in page  # an example, with its prompts as such
    for path in (site / "reference").glob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert "TypeAliasForwardRef" not in text
        assert "Args:" not in text and "Example:" not in text, f"{path.name}: a section that was not recognised"


def test_every_file_that_the_pages_name_exists():
    there = [path for path in ROOT.rglob("*") if not path.relative_to(ROOT).parts[0].startswith(".")]
    names = ["/" + path.relative_to(ROOT).as_posix() + "/" * path.is_dir() for path in there]
    folders = "|".join({path.name for root in (ROOT, ROOT / "fsh3d_o3d") for path in root.iterdir() if path.is_dir()})
    # A file of somebody else's, a layout of a library, and what running the experiments makes.
    elsewhere = {"numpy.py", "1/m123/m123.obj", "output/paper/"}
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        text = page.read_text(encoding="utf-8")
        named = set(re.findall(r"`([\w.*-]+/[\w./*-]*)`", text)) | set(re.findall(r"[\w./*-]+\.py\b", text))
        named |= set(re.findall(rf"(?<![\w./-])(?:{folders})/[\w./*-]*\w\.\w+", text))
        for name in named - elsewhere:
            wanted = "*/" + name.removeprefix("../")
            assert any(fnmatch(path, wanted) for path in names), f"{page.name} names {name}, which is not there"


def test_every_name_of_the_package_that_the_pages_give_exists():
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"\bfsh\.\w+", text):
            assert hasattr(fsh, name.removeprefix("fsh.")), f"{page.name}: {name}"
        for name in re.findall(r"(?<!/)\bfsh3d_o3d(?:\.[a-z]\w+)+", text):
            if HAS_TORCH or name != "fsh3d_o3d.torch":
                pkgutil.resolve_name(name)
        for module, names in re.findall(r"^from (fsh3d_o3d[.\w]*) import (.+)$", text, flags=re.MULTILINE):
            for name in names.split(","):
                if name.strip() == "torch as ft":
                    assert (ROOT / "fsh3d_o3d" / "torch" / "__init__.py").exists()  # a folder that loads PyTorch
                else:
                    pkgutil.resolve_name(f"{module}:{name.strip()}")


def test_every_page_can_be_reached(site):
    start = (site / "index.html").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert f'href="{page.stem}.html"' in start or page.stem == "index", page


def test_nothing_is_loaded_from_elsewhere(site):
    for path in site.rglob("*.html"):
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"([^\"]+)\"", path.read_text("utf-8"))
        assert loaded
        assert not [address for address in loaded if re.match(r"(?:https?:)?//", address)], path
    for path in site.rglob("*.css"):
        assert not re.search(r"url\(\s*[\"']?(?:https?:)?//|@import", path.read_text(encoding="utf-8")), path
