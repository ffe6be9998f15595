"""Fixtures for all tests: seeded randomness and a private cache folder."""

from __future__ import annotations

import signal
import zlib
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import numpy as np
import pytest

# A shell that runs this in the background makes it and its children deaf to Ctrl-C, and `nohup` to the end of a
# terminal. Some tests send both to their children.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The same examples on every machine and every run: a change fails for what it changes, not for what was drawn. No
# deadline (a shared machine may pause for longer than 200 ms; no test is about time), no examples kept between runs.
hypothesis.settings.register_profile("fsh3d", derandomize=True, database=None, deadline=None, max_examples=25)
# `make fuzz`: other examples each time, and what repeats the one that fails.
hypothesis.settings.register_profile(
    "fuzz", derandomize=False, database=None, deadline=None, max_examples=200, print_blob=True
)
hypothesis.settings.load_profile("fsh3d")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seed", type=int, default=20240, help="seed of the `rng` fixture")


def pytest_report_header(config: pytest.Config) -> str:
    return f"seed: {config.getoption('--seed')} (repeat with --seed)"


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator that depends on --seed and on the test, not on which tests run before it."""
    return np.random.default_rng([request.config.getoption("--seed"), zlib.crc32(request.node.nodeid.encode())])


@pytest.fixture
def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation matrix (3, 3), uniformly distributed."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


@pytest.fixture(scope="session", autouse=True)
def private_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Point the package's cache to a folder of this session: tests neither use nor fill the user's."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FSH3D_CACHE_DIR", str(folder))
        yield folder
