"""Fixtures shared by all tests."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

# On small matrices the threads of the BLAS that NumPy, SciPy and pycolmap each bring along wait for
# each other more than they work: twenty times the processor time in tests/solving/solve. Each asks
# once, when it is loaded; bundle's own BLAS, and processes of the tests, find the variable as it
# was.
_asked_for = os.environ.get("OPENBLAS_NUM_THREADS")
os.environ["OPENBLAS_NUM_THREADS"] = "1"
import numpy  # noqa: E402, F401
import pycolmap  # noqa: E402, F401
import scipy.linalg  # noqa: E402, F401

if _asked_for is None:
    del os.environ["OPENBLAS_NUM_THREADS"]
else:
    os.environ["OPENBLAS_NUM_THREADS"] = _asked_for

import pytest  # noqa: E402

import bundle  # noqa: E402
from tests import made_up_machine  # noqa: E402

REPOSITORY = Path(__file__).resolve().parent.parent

gc.disable()  # it takes a quarter of the time in which pytest collects the tests

# Workers of pytest-xdist have it; reports take it for the width of a terminal.
os.environ.pop("COLUMNS", None)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Collect garbage from here on, but not among half a million objects of the tests."""
    gc.freeze()
    gc.enable()


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


@pytest.fixture(scope="session", autouse=True)
def predictions_for_a_made_up_machine() -> Iterator[None]:
    """Calibrate nothing: the rates of this machine take ten seconds and differ between runs."""
    with pytest.MonkeyPatch.context() as patch:
        made_up_machine.predict_for_it(patch)
        yield


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
