"""Thumbnails and HTML pages that work offline."""
