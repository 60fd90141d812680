"""The logger "bundle"."""

import logging
import subprocess
import sys

import pytest

import bundle
from bundle.base.own_process import log
from tests.scenes import make_problem


@pytest.fixture
def problem():
    return make_problem(num_images=3, num_points=12)


def test_start_and_end_of_a_solve_and_each_iteration(problem, caplog):
    caplog.set_level(logging.DEBUG, logger="bundle")
    seen = []
    result = bundle.solve(problem, progress=seen.append)
    levels = [record.levelname for record in caplog.records]
    assert {record.name for record in caplog.records} == {"bundle"}
    assert (levels[0], levels[-1]) == ("INFO", "INFO")
    assert levels[1:-1] == ["DEBUG"] * len(seen) == ["DEBUG"] * len(result.iterations["cost"])
    assert f"{result.iterations['cost'][-1]:.9e}" in caplog.text
    assert caplog.records[-1].getMessage() == result.outcome


def test_warnings_of_a_solve(problem, caplog):
    caplog.set_level(logging.INFO, logger="bundle")
    result = bundle.solve(
        problem, linear_solver_type="dense_schur", preconditioner_type="schur_jacobi"
    )
    warned = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert warned == list(result.summary.warnings)
    assert warned


@pytest.mark.parametrize("first", ["", "import logging; "])
def test_without_a_handler_nothing_is_printed_and_logging_is_not_imported(first):
    script = f"""{first}import sys, bundle
from bundle.base.own_process import log
from tests.scenes import make_problem
problem = make_problem(num_images=3, num_points=12)
bundle.solve(problem, linear_solver_type="dense_schur", preconditioner_type="schur_jacobi")
assert "logging" in sys.modules or not {bool(first)}
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(("level", "calls"), [(logging.INFO, 1), (logging.WARNING, 0)])
def test_a_value_is_made_for_a_message_that_is_shown(caplog, level, calls):
    caplog.set_level(level, logger="bundle")
    made = []
    log("info", "%d of %s", 3, lambda: made.append(1) or "seven")
    assert [r.getMessage() for r in caplog.records] == ["3 of seven"] * calls
    assert len(made) == calls
