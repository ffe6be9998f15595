"""Sphinx's configuration. `make docs` writes the site to output/site: the pages here, and what the docstrings say."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))  # api_reference

project = "fsh3d_o3d"
extensions = ["myst_parser", "sphinx.ext.autodoc", "api_reference"]
exclude_patterns = ["images"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = "fsh3d_o3d"
html_copy_source = False
html_show_copyright = False

autodoc_class_signature = "mixed"
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
# Names of array types, which would be written out otherwise.
autodoc_type_aliases = {name: name for name in ("BoolArray", "Float64Array", "FloatArray", "IntArray")}
maximum_signature_line_length = 88
