"""What holds for all tests of the index."""

from __future__ import annotations

import math

import pytest

from fsh3d_o3d.index import filling


@pytest.fixture(autouse=True)
def batches_by_number_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are written as soon as there are enough, however long that takes: the same batches on a busy machine."""
    monkeypatch.setattr(filling, "_SECONDS_A_COMMIT", math.inf)
