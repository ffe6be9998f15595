"""Fixtures of the reports' tests."""

import pytest


@pytest.fixture
def small_page(monkeypatch):
    """Pages with a stub for plotly's five million characters and small pictures; the browser's tests take the real."""
    monkeypatch.setattr("plotly.offline.get_plotlyjs", lambda: "// plotly.js\r\nvar Plotly;\r")
    monkeypatch.setattr("fsh3d_o3d.report.page._SIDE", 40)
