"""Fixtures shared by all tests."""

import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

import bundle

REPOSITORY = Path(__file__).resolve().parent.parent


# Workers of pytest-xdist have it; reports take it for the width of a terminal.
os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="session")
def bundle_data() -> Path:
    """The folder of real data: environment variable BUNDLE_DATA, or ../shared/data.

    Without it a test is skipped; under continuous integration (CI=true) it fails.
    """
    folder = Path(os.environ.get("BUNDLE_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        reason = f"no real data at {folder} (set BUNDLE_DATA)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(params=["ceres", "fused"])
def backend(request: pytest.FixtureRequest) -> str:
    """Each backend in turn."""
    name: str = request.param
    return name


@pytest.fixture
def solve(backend: str) -> Callable[..., bundle.Result]:
    """bundle.solve by each backend in turn."""
    return partial(bundle.solve, backend=backend)


@pytest.fixture(scope="session", autouse=True)
def ctrl_c_works() -> Iterator[None]:
    """Let SIGINT interrupt this process and its children, as in an interactive shell.

    A shell without job control starts what runs in its background with SIGINT ignored.
    """
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)
