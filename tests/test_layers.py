"""The structure of the package: imports go one way, Open3D comes late, public names are documented."""

from __future__ import annotations

import ast
import graphlib
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import fsh3d_o3d
from tests.optional import skip_without_torch

PACKAGE = Path(fsh3d_o3d.__file__).parent
FLOORS = [
    "sphere",
    "geometry",
    "files",
    "sphere_map",
    "shells",
    "closing",
    "radial",
    "shapes",
    "reconstruction",
    "descriptors",
    "registration",
    "torch",
    "jobs",
    "evaluation",
    "index",
    "report",
    "cli",
]
"""Folders of the package from the ground up: each may import those before it."""
BESIDE = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
"""Files beside the folders, for all of them; Open3D is not for the sphere."""
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [path.relative_to(PACKAGE).as_posix() for path in FILES]
DOORS = {path.parent.relative_to(PACKAGE).parts for path in PACKAGE.rglob("__init__.py")} - {()}
OUTSIDE = sorted(path for folder in ("pipelines", "benchmarks") for path in (PACKAGE.parent / folder).rglob("*.py"))


def imported(path: Path) -> Iterator[str]:
    """Dotted names of everything a file imports, at its top, in functions and for type checkers alike."""
    module = path.relative_to(PACKAGE.parent).with_suffix("").parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(module[: -node.level]) if node.level else ""
            start = ".".join(part for part in (base, node.module) if part)
            yield from (f"{start}.{alias.name}" for alias in node.names)


def own_imports(path: Path) -> list[tuple[str, ...]]:
    """What a file imports of this package, as the parts of names below it."""
    names = [tuple(name.split(".")) for name in imported(path)]
    return [name[1:] for name in names if name[0] == "fsh3d_o3d"]


def past_a_door(own: tuple[str, ...], name: tuple[str, ...]) -> bool:
    """Whether an import from folder ``own`` takes ``name`` out of another folder without asking at its door."""
    folder = next((name[:depth] for depth in range(len(name), 0, -1) if name[:depth] in DOORS), ())
    if own[: len(folder)] == folder:  # the file's own folder, or one around it
        return False
    shared = next(depth for depth in range(len(folder)) if own[depth : depth + 1] != folder[depth : depth + 1])
    door = folder[: shared + 1]  # the outermost folder that the file is not in
    if len(name) != len(door) + 1 or name[-1].startswith("_"):
        return True
    return name[-1] not in importlib.import_module(".".join(("fsh3d_o3d", *door))).__all__


def test_every_folder_has_its_floor() -> None:
    assert sorted(FLOORS) == sorted(door[0] for door in DOORS if len(door) == 1)


def test_the_architecture_page_lists_the_folders_from_the_top_down() -> None:
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("| folder | holds |\n|---|---|\n")[2].partition("\n\n")[0]
    rows = [re.fullmatch(r"\| `(\w+)/` \| (.+) \|", line) for line in table.splitlines()]
    assert [row and row[1] for row in rows] == FLOORS[::-1]


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_imports_go_down(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[:-1]
    if not own and path.name == "__init__.py":
        return  # the package's own door
    below = FLOORS[: FLOORS.index(own[0]) + 1] if own else []
    allowed = {*below, *BESIDE} - ({"_open3d"} if own[:1] == ("sphere",) else set())
    if own[:1] == ("cli",):
        allowed |= set(fsh3d_o3d.__all__)  # the top floor may use the package as users do
    assert [".".join(name) for name in own_imports(path) if not name or name[0] not in allowed] == []


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_no_import_goes_past_a_door(path: Path) -> None:
    own = path.relative_to(PACKAGE).parts[:-1]
    assert [".".join(name) for name in own_imports(path) if past_a_door(own, name)] == []


def test_files_do_not_import_each_other_in_circles() -> None:
    """Neither at their tops nor in functions nor for type checkers: what two files share stands in a third."""
    files = {path.relative_to(PACKAGE).with_suffix("").parts for path in FILES}
    doors = {(*door, "__init__"): door for door in DOORS}

    def home(name: tuple[str, ...]) -> tuple[str, ...]:
        """The file that an import takes ``name`` from; the package's own door for its own names."""
        starts = (name[:depth] for depth in range(len(name), 0, -1))
        return next((one for one in starts if one in files or one in DOORS), ())

    needs = {
        doors.get(own, own): {home(name) for name in own_imports(path)}
        for own, path in ((path.relative_to(PACKAGE).with_suffix("").parts, path) for path in FILES)
    }
    assert needs["sphere", "weight_cache"] >= {("sphere", "grids"), ("sphere", "weight_solution")}
    graphlib.TopologicalSorter(needs).prepare()  # CycleError, which names the files, where there is a circle


@pytest.mark.parametrize("path", OUTSIDE, ids=lambda path: path.relative_to(PACKAGE.parent).as_posix())
def test_scripts_come_in_through_the_doors(path: Path) -> None:
    """What ``import fsh3d_o3d`` offers, or what stands in a folder's door, and exists; and the door of ``torch``."""
    offered = {(name,) for name in fsh3d_o3d.__all__} | {(), ("torch",)}
    assert [
        ".".join(name)
        for name in own_imports(path)
        if name not in offered and (name[:1] not in DOORS or past_a_door((), name))
    ] == []


@pytest.mark.parametrize("door", sorted(DOORS), ids=".".join)
def test_a_door_says_what_its_folder_is_and_offers_what_exists(door: tuple[str, ...]) -> None:
    skip_without_torch(needed=door[0] == "torch")
    module = importlib.import_module(".".join(("fsh3d_o3d", *door)))
    assert module.__doc__ and len(module.__doc__.split()) >= 8
    assert len(module.__all__) == len(set(module.__all__))
    assert [name for name in module.__all__ if not hasattr(module, name) or name.startswith("_")] == []


@pytest.mark.parametrize("stub", sorted(PACKAGE.rglob("__init__.pyi")), ids=lambda stub: stub.parent.name)
def test_a_lazy_door_and_its_folder_share_no_name(stub: Path) -> None:
    """Importing a file puts it into its folder's door, over a function of the same name that waits to be asked for."""
    files = {path.stem for path in stub.parent.glob("*.py")}
    module = importlib.import_module(".".join(("fsh3d_o3d", *stub.parent.relative_to(PACKAGE).parts)))
    assert files & set(module.__all__) == set()


@pytest.mark.parametrize("module", ["fsh3d_o3d.geometry"])
def test_a_lazy_door_loads_only_what_is_asked_for(module: str) -> None:
    code = f"import sys; from {module} import MeshArrays; print([n for n in sys.modules if n.startswith('scipy')])"
    code = code.replace(
        "import sys; ",
        "import sys, types; sys.modules['fsh3d_o3d'] = p = types.ModuleType('fsh3d_o3d'); "
        f"p.__path__ = [{str(PACKAGE)!r}]; ",
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_open3d_is_imported_in_one_place(path: Path) -> None:
    assert [name for name in imported(path) if name.split(".")[0] == "open3d"] == []
    mentions = '"open3d"' in path.read_text(encoding="utf-8")
    assert path.name == "_open3d.py" or not (mentions and "import_module" in path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("module", ["fsh3d_o3d", "fsh3d_o3d.cli"])
def test_import_is_light(module: str) -> None:
    """Open3D, plotly and PyTorch take seconds to import: nothing does before they are needed."""
    heavy = "PIL jinja2 lancedb matplotlib open3d plotly pyarrow pymeshlab ray scipy.ndimage skimage torch"
    code = f"import sys, {module}; print(sorted(set('{heavy}'.split()) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    assert done.stdout.strip() == "[]"


def test_sphere_works_where_open3d_is_missing() -> None:
    code = (
        "import sys; sys.modules['open3d'] = None\n"
        "import fsh3d_o3d as fsh\n"
        "t = fsh.SphericalHarmonicTransform(4)\n"
        "print(round(float(t.forward(t.grid.directions[:, 2] * 0 + 1)[0] ** 2), 9))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PACKAGE.parent, check=True)
    assert done.stdout.strip() == "12.566370614"


def public_names(tree: ast.Module) -> list[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__":
            assert isinstance(node.value, ast.List)
            return [item.value for item in node.value.elts if isinstance(item, ast.Constant)]
    return []


def is_text(node: ast.stmt | None) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_public_names_exist_and_are_documented(path: Path) -> None:
    """Functions, classes and their public methods, dataclass fields and constants; a constant's text follows it."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree), "the module has no docstring"
    public = public_names(tree)
    assert len(public) == len(set(public))
    missing: list[str] = []
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name in public:
            if not ast.get_docstring(node):
                missing.append(node.name)
            if isinstance(node, ast.ClassDef):
                missing += undocumented_members(node)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            own = [target.id for target in targets if isinstance(target, ast.Name) and target.id in public]
            missing += [name for name in own if not is_text(after)]
    assert missing == []
    module = ".".join(("fsh3d_o3d", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
    if public:
        skip_without_torch(needed=module.startswith("fsh3d_o3d.torch"))
        __import__(module)
        assert [name for name in public if not hasattr(sys.modules[module], name)] == []


def undocumented_members(node: ast.ClassDef) -> Iterator[str]:
    for member, after in zip(node.body, [*node.body[1:], None], strict=True):
        if isinstance(member, ast.FunctionDef) and not member.name.startswith("_") and not ast.get_docstring(member):
            yield f"{node.name}.{member.name}"
        field = member.target if isinstance(member, ast.AnnAssign) else None
        if isinstance(field, ast.Name) and not field.id.startswith("_") and not is_text(after):
            yield f"{node.name}.{field.id}"


def test_every_public_name_of_the_package_is_documented() -> None:
    assert len(fsh3d_o3d.__all__) == len(set(fsh3d_o3d.__all__))
    for name in fsh3d_o3d.__all__:
        value = getattr(fsh3d_o3d, name)
        assert name == "__version__" or (value.__doc__ or "").strip(), name


def test_modules_stay_short() -> None:
    long = [name for name, path in zip(NAMES, FILES, strict=True) if len(path.read_text("utf-8").splitlines()) > 350]
    assert long == []
