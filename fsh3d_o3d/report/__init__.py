"""Pictures and pages of results: thumbnails without a graphics card, HTML that works offline."""

from __future__ import annotations

from fsh3d_o3d.report.alignment import alignment_picture
from fsh3d_o3d.report.library_thumbnail import library_thumbnail
from fsh3d_o3d.report.page import reconstruction_picture, write_reconstruction_page
from fsh3d_o3d.report.scans import scans_picture
from fsh3d_o3d.report.search_page import SearchResult, write_search_page
from fsh3d_o3d.report.thumbnail import encode_png, error_colors, render_thumbnail, side_by_side

__all__ = [
    "SearchResult",
    "alignment_picture",
    "encode_png",
    "error_colors",
    "library_thumbnail",
    "reconstruction_picture",
    "render_thumbnail",
    "scans_picture",
    "side_by_side",
    "write_reconstruction_page",
    "write_search_page",
]
