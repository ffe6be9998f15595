"""Pages from the templates of this folder, which take what they are given for text and never for HTML."""

from __future__ import annotations

import base64
import functools
import hashlib
import os
from importlib import resources
from typing import Any

from fsh3d_o3d._atomic import atomic_write_bytes
from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._printable import printable
from fsh3d_o3d._version import __version__
from fsh3d_o3d.report.figures import percent_text


def write_page(path: str | os.PathLike[str], template: str, *, data: Any, **values: Any) -> None:
    """Write a page that works offline, may run nothing but plotly and one of our scripts, and loads nothing.

    Args:
        path: The HTML file; replaced as a whole or not at all.
        template: Name of a file in ``report/templates``.
        data: For the page's script, as JSON without NaN.
        values: What the template shows, ``title`` among it. All text is escaped, as HTML and where it hides something.
    """
    text = _templates().get_template(template).render(values, data=data, plotly=_plotly())
    atomic_write_bytes(path, text.encode("utf-8"))


@functools.cache
def _templates() -> Any:
    """Return the environment of the templates; made here because pages are rare and Jinja takes a moment to import."""
    jinja = import_installed("jinja2")
    trusted = import_installed("markupsafe").Markup

    def asset(name: str) -> Any:
        return trusted(resources.files("fsh3d_o3d.report").joinpath("assets", name).read_text(encoding="utf-8"))

    environment = jinja.Environment(
        loader=jinja.PackageLoader("fsh3d_o3d.report"),
        autoescape=True,
        finalize=lambda value: value if hasattr(value, "__html__") else printable(value),
        undefined=jinja.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"asset": asset, "version": __version__}
    environment.filters |= {
        "basename": os.path.basename,  # of any bytes
        "percent": percent_text,
        "png": lambda png: trusted("data:image/png;base64," + base64.b64encode(png).decode("ascii")),
        "sha256": lambda code: base64.b64encode(hashlib.sha256(code.encode()).digest()).decode("ascii"),
    }
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _plotly() -> Any:
    code = import_installed("plotly.offline").get_plotlyjs()
    # HTML reads every line end as a line feed, so the hash in the page's policy must too.
    return import_installed("markupsafe").Markup(code.replace("\r\n", "\n").replace("\r", "\n"))
