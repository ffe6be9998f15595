"""HTML that holds what it was given, and nothing that was given as HTML."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

from fsh3d_o3d._imports import import_installed
from fsh3d_o3d._printable import printable
from fsh3d_o3d.report.figures import Figure


def escaped(text: str) -> str:
    """Return text as HTML, in one line, in an element or in a quoted attribute; what is hidden in it is escaped."""
    return html.escape(printable(text))


def asset(name: str) -> str:
    """Return a file of the package's ``report/assets``."""
    return resources.files("fsh3d_o3d.report").joinpath("assets", name).read_text(encoding="utf-8")


def data_block(identifier: str, value: Any) -> str:
    """Return a script element that holds JSON, which nothing in the value can close."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" id="{identifier}">{text}</script>'


def code_block(code: str) -> tuple[str, str]:
    """Return a script element, and the source expression by which a content security policy lets exactly it run."""
    # HTML reads every line end as a line feed, so the hash must too.
    text = "\n" + code.replace("\r\n", "\n").replace("\r", "\n") + "\n"
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"<script>{text}</script>", f"'sha256-{digest}'"


def png_source(png: bytes) -> str:
    """Return a PNG file as the address of an image."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def table(caption: str, rows: Sequence[Figure]) -> str:
    """Return a table of figures with a header for each row; the meaning stands below the name."""
    body = "".join(
        f'<tr><th scope="row">{escaped(row.label)}'
        + (f"<small>{escaped(row.meaning)}</small>" if row.meaning else "")
        + f"</th><td>{escaped(row.value)}</td></tr>"
        for row in rows
    )
    head = "".join(f'<th scope="col"><span class="unseen">{name}</span></th>' for name in ("Figure", "Value"))
    return f"<table><caption>{escaped(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def document(title: str, body: str, data: Any, *, script: str, styles: Sequence[str]) -> str:
    """Return a page that works offline, may run nothing but plotly and one of our scripts, and loads nothing.

    Args:
        title: As text.
        body: As HTML.
        data: For the script, as JSON.
        script: Asset.
        styles: Assets, in order.
    """
    # Imported here: the pages are rare and plotly takes a moment.
    get_plotlyjs = import_installed("plotly.offline").get_plotlyjs

    library, library_source = code_block(get_plotlyjs())
    page, page_source = code_block(asset(script))
    # Plotly styles elements and builds functions from text; nothing may come from elsewhere.
    policy = (
        f"default-src 'none'; script-src {library_source} {page_source} 'unsafe-eval'; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escaped(title)}</title>",
            f"<style>\n{''.join(map(asset, styles))}</style>",
            "</head>",
            "<body>",
            body,
            data_block("report-data", data),
            library,
            page,
            "</body>",
            "</html>",
            "",
        ]
    )
