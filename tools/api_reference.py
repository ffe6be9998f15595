"""A Sphinx extension: pages of the API reference, made from what the package exports.

``__all__`` is grouped by comments; each group becomes a page with a directive for every name. So what is exported is
documented, and nothing else is. Docstrings are Google style, in which Sphinx misreads a few of our signs.
"""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import GoogleDocstring

import fsh3d_o3d

PACKAGE = "fsh3d_o3d"
FOLDER = "reference"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx, which calls this."""
    app.connect("builder-inited", _write_pages)
    app.connect("autodoc-process-docstring", _read_docstring)
    app.connect("autodoc-process-signature", _read_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def subjects(module: str = PACKAGE) -> dict[str, list[str]]:
    """Return the names in a package's ``__all__`` by the comment above them; those before any comment under ``""``.

    Where another package's list is spread into it, that one's comments count.
    """
    source = (Path(fsh3d_o3d.__file__).parents[1] / module.replace(".", "/") / "__init__.py").read_text("utf-8")
    tree, lines = ast.parse(source), source.splitlines()
    homes = {
        alias.asname: node.module
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
        if alias.name == "__all__"
    }
    exported = next(
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.List)
        and ast.unparse(node.targets[0]) == "__all__"
    )
    groups: dict[str, list[str]] = {}
    subject, line = "", exported.lineno
    for element in exported.elts:
        above = [text.strip() for text in lines[line : element.lineno - 1]]
        subject = next((text.lstrip("# ") for text in reversed(above) if text.startswith("#")), subject)
        line = element.lineno
        if isinstance(element, ast.Starred):
            for inner, names in subjects(homes[ast.unparse(element.value)]).items():
                groups.setdefault(inner or subject, []).extend(names)
        else:
            groups.setdefault(subject, []).append(ast.literal_eval(element))
    return groups


def _write_pages(app: Sphinx) -> None:
    """Write ``reference/index.rst`` and a page for each subject; unchanged ones keep their time."""
    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    groups = subjects()
    pages = {subject.replace(" ", "-"): _page(subject, names) for subject, names in groups.items() if subject}
    pages["index"] = _overview(groups, list(pages))
    for stale in {path.stem for path in folder.glob("*.rst")} - set(pages):
        (folder / f"{stale}.rst").unlink()
    for name, text in pages.items():
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def _page(subject: str, names: list[str]) -> str:
    directives = "".join(f"\n.. auto{_kind(getattr(fsh3d_o3d, name))}:: {name}\n" for name in names)
    return f"{_heading(subject.capitalize())}\n.. currentmodule:: {PACKAGE}\n{directives}"


def _overview(groups: dict[str, list[str]], pages: list[str]) -> str:
    toctree = "".join(f"   {page}\n" for page in pages)
    tables = "".join(
        f"\n.. rubric:: {subject.capitalize()}\n\n.. list-table::\n   :widths: 34 66\n\n" + "".join(map(_row, names))
        for subject, names in groups.items()
        if subject
    )
    return (
        f"{_heading('API reference')}\nWhat ``import {PACKAGE} as fsh`` offers, version {fsh3d_o3d.__version__} "
        f"(``fsh.__version__``). :doc:`../conventions` says what arrays mean.\n\n.. toctree::\n   :hidden:\n\n{toctree}"
        f"\n.. currentmodule:: {PACKAGE}\n{tables}"
    )


def _row(name: str) -> str:
    summary = (inspect.getdoc(getattr(fsh3d_o3d, name)) or "").partition("\n")[0]
    return f"   * - :obj:`{name}`\n     - {_escaped(summary)}\n"


def _heading(text: str) -> str:
    return f"{text}\n{'=' * len(text)}\n"


def _kind(value: object) -> str:
    if inspect.isclass(value):
        return "exception" if issubclass(value, BaseException) else "class"
    return "function" if callable(value) else "data"


def _read_docstring(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    """Turn a Google docstring into reStructuredText.

    In place of napoleon's own handler, which takes what stands before a colon in an attribute's docstring for its type.
    """
    kind: Any = "method" if what in ("attribute", "data", "property") else what
    style: Any = Config(napoleon_use_rtype=False)  # what stands before a colon is a name more often than a type
    lines[:] = GoogleDocstring(list(map(_escaped, lines)), style, app, kind, name, obj, options).lines()


def _escaped(line: str) -> str:
    """A line in which bars are bars, public names are links, and literals end where a word follows at once (n³)."""
    parts = re.split(r"``(.+?)``", line)  # every second one is a literal
    parts[::2] = [part.replace("|", "\\|") for part in parts[::2]]
    parts[2::2] = [re.sub(r"^(?=\w)", r"\\ ", part) for part in parts[2::2]]
    public = set(fsh3d_o3d.__all__)
    parts[1::2] = [f":obj:`~{PACKAGE}.{part}`" if part in public else f"``{part}``" for part in parts[1::2]]
    return "".join(parts)


def _read_signature(
    app: Sphinx, what: str, name: str, obj: object, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Undo how Sphinx shows type aliases inside of other types."""
    plain = [text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (signature, returned)]
    return plain[0], plain[1]
