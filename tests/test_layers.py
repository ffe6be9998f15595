"""The structure of the package: imports go one way, Open3D comes late, public names are documented."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import fsh3d_o3d

PACKAGE = Path(fsh3d_o3d.__file__).parent
# Each may import those before it.
LAYERS = ["sphere", "adapters", "shapes", "descriptors.py", "registration.py", "retrieval", "report", "cli"]
# Private modules beside a layer that is one file.
PARTS = {
    "descriptors.py": {"_shd_option", "_cpshd"},
    "registration.py": {"_registration_fit", "_registration_search", "_registration_surface"},
}
MODULES = [layer.removesuffix(".py") for layer in LAYERS]
BESIDE = {
    "_validation",
    "_atomic",
    "_cache_folder",
    "_imports",
    "_npz",
    "_printable",
    "_regular_file",
    "errors",
    "_version",
}  # beside the layers, for all of them
FILES = sorted(PACKAGE.rglob("*.py"))
NAMES = [path.relative_to(PACKAGE).as_posix() for path in FILES]


def imported(path: Path) -> Iterator[str]:
    """Dotted names of everything a file imports, at its top, in functions and for type checkers alike."""
    module = ("fsh3d_o3d", *path.relative_to(PACKAGE).with_suffix("").parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(module[: -node.level]) if node.level else ""
            start = ".".join(part for part in (base, node.module) if part)
            yield from (f"{start}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_imports_go_down(path: Path) -> None:
    first = path.relative_to(PACKAGE).parts[0]
    layer = next((layer for layer, parts in PARTS.items() if first.removesuffix(".py") in parts), first)
    if layer not in LAYERS:
        allowed = {*MODULES, *BESIDE, "_open3d"} if layer == "__init__.py" else BESIDE
    else:
        allowed = {*MODULES[: MODULES.index(layer.removesuffix(".py")) + 1], *BESIDE}
        if layer != "sphere":
            allowed.add("_open3d")
        allowed |= {part for name, parts in PARTS.items() if name.removesuffix(".py") in allowed for part in parts}
        if layer == "cli":
            allowed |= vars(fsh3d_o3d).keys()  # the top layer may use the package as users do
    own = [name.split(".") for name in imported(path) if name.split(".")[0] == "fsh3d_o3d"]
    wrong = [".".join(parts) for parts in own if len(parts) > 1 and parts[1] not in allowed]
    if layer in LAYERS[:-1]:
        wrong += [".".join(parts) for parts in own if len(parts) == 1]  # the whole package, from inside it
    assert wrong == []


@pytest.mark.parametrize("path", FILES, ids=NAMES)
def test_open3d_is_imported_in_one_place(path: Path) -> None:
    assert [name for name in imported(path) if name.split(".")[0] == "open3d"] == []
    mentions = '"open3d"' in path.read_text(encoding="utf-8")
    assert path.name == "_open3d.py" or not (mentions and "import_module" in path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("module", ["fsh3d_o3d", "fsh3d_o3d.cli"])
def test_import_is_light(module: str) -> None:
    """Open3D and plotly take seconds to import: nothing does before they are needed."""
    code = f"import sys, {module}; print(sorted({{'open3d', 'plotly', 'matplotlib'}} & set(sys.modules)))"
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
    long = [name for name, path in zip(NAMES, FILES, strict=True) if len(path.read_text("utf-8").splitlines()) > 300]
    assert long == []
