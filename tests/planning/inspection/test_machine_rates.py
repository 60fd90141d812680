"""Rates of this machine: fitted, cached, read again, measured again where they do not fit."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

import bundle
from bundle.planning.inspection import (
    factor_graph_time,
    machine_rates,
    pose_graph_time,
    problem_time,
)
from bundle.planning.inspection.machine_rates import (
    ATTEMPTS,
    LARGEST_MISFIT,
    Rates,
    cache_path,
    cached_rates,
    fitted,
)

FEATURES = ("step", "flop", "entry")
RATES = Rates(
    num_threads=1, seconds={"step": 1e-6, "flop": 1e-10, "entry": 0.0}, misfit=0.1, efficiency=0.7
)


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def asked():
    """Numbers of threads of each calibration, replaced by one that takes no time."""
    return []


@pytest.fixture
def rates(asked):
    """Cached rates of a table, by a calibration that takes no time."""

    def calibrate(num_threads):
        asked.append(num_threads)
        return dataclasses.replace(RATES, num_threads=num_threads)

    def found(num_threads=1, **options):
        return cached_rates("some", FEATURES, num_threads, calibrate, **options)

    return found


def test_measured_once_for_each_number_of_threads(rates, asked, cache):
    assert rates() == rates() == RATES
    assert rates(2).num_threads == 2
    assert asked == [1, 2]
    assert cache_path("some", 1).parent == cache / "bundle"


def test_recalibrate(rates, asked):
    rates()
    rates(recalibrate=True)
    assert asked == [1, 1]


GOOD = dataclasses.asdict(RATES)
BAD = {
    "another value": {"seconds": 3},
    "without a feature": {"seconds": {"step": 1.0, "flop": 1.0}},
    "another feature": {"seconds": {**RATES.seconds, "pair": 1.0}},
    "no number": {"seconds": {**RATES.seconds, "flop": math.nan}},
    "negative": {"seconds": {**RATES.seconds, "flop": -1e-9}},
    "efficiency": {"efficiency": math.nan},
    "that does not fit": {"misfit": 1.1 * LARGEST_MISFIT},
    "another member": {"speed": 1.0},
}


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"num_threads": 1}', *BAD])
def test_a_bad_file_is_replaced(rates, asked, content):
    path = cache_path("some", 1)
    path.parent.mkdir()
    path.write_text(json.dumps(GOOD | BAD[content]) if content in BAD else content)
    assert rates() == rates() == RATES
    assert asked == [1]


def test_a_good_file_is_read(rates, asked):
    path = cache_path("some", 1)
    path.parent.mkdir()
    path.write_text(json.dumps(GOOD | {"efficiency": 0.25}))
    assert rates() == dataclasses.replace(RATES, efficiency=0.25)
    assert not asked


def test_without_a_place_to_keep_them(rates, asked, monkeypatch, cache):
    (cache / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "file"))
    assert rates() == rates() == RATES
    assert asked == [1, 1]


def test_a_relative_cache_is_ignored(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_path("some", 1).parent == tmp_path / "home" / ".cache" / "bundle"


def test_instruction_sets_have_rates_of_their_own(monkeypatch):
    usual = cache_path("some", 1)
    monkeypatch.setenv("BUNDLE_INSTRUCTION_SET", "baseline")
    assert cache_path("some", 1) != usual


@pytest.mark.parametrize("disturbed", range(1, ATTEMPTS + 1))
def test_a_disturbed_calibration_is_repeated_and_never_kept(disturbed):
    bad = dataclasses.replace(RATES, misfit=1.1 * LARGEST_MISFIT)
    worse = dataclasses.replace(bad, misfit=9.0)
    answers = iter([*[worse, bad, worse][:disturbed], RATES])

    def calibrate(_):
        return next(answers)

    kept = disturbed < ATTEMPTS
    assert cached_rates("some", FEATURES, 1, calibrate) == (RATES if kept else bad)
    assert cache_path("some", 1).exists() == kept
    assert cached_rates("some", FEATURES, 1, calibrate) == RATES


@pytest.mark.parametrize(
    "what", ["_processor", "_blas", "hardware_threads", "__version__", "CERES_VERSION", "node"]
)
def test_the_key_holds_what_rates_depend_on(monkeypatch, what):
    usual = cache_path("some", 1)
    assert cache_path("some", 1) == usual != cache_path("other", 1)
    if what in ("_processor", "_blas"):
        monkeypatch.setattr(machine_rates, what, lambda: ("another",))
    elif what == "node":
        monkeypatch.setattr(machine_rates.platform, "node", lambda: "another")
    elif what == "hardware_threads":
        monkeypatch.setattr(machine_rates._core, what, lambda: 1000)
    else:
        monkeypatch.setattr(machine_rates._core, what, "another")
    assert cache_path("some", 1) != usual


def test_the_blas_that_is_loaded_is_found():
    assert any("blas" in entry for entry in machine_rates._blas())


def test_terms_are_the_work_by_the_rates():
    work = {"solve": {"flop": 1e6, "entry": 5.0}, "other": {"step": 2}}
    assert RATES.terms(work) == pytest.approx({"solve": 1e-4, "other": 2e-6})


def test_rates_reproduce_the_times_that_they_are_fitted_to():
    works = [{"solve": {"flop": f, "entry": e}, "other": {"step": 1.0}} for f, e in
             ((1e6, 1e3), (1e7, 1e3), (1e6, 1e5), (1e8, 1e4), (5e6, 5e4))]  # fmt: skip
    true = Rates(num_threads=2, seconds={"step": 1e-4, "flop": 1e-10, "entry": 1e-8})
    times = [sum(true.terms(work).values()) for work in works]
    found = fitted(FEATURES, 2, zip(works, times, strict=True))
    assert found.seconds == pytest.approx(true.seconds, rel=1e-5)
    assert found.num_threads == 2 and found.misfit < 1e-8
    # Relative errors of two times of one work: s (1 +- x) - 1, with the best s = 1 / (1 + x^2).
    twice = [(works[0], 1 / (1 + x)) for x in (0.3, -0.3)]
    assert fitted(FEATURES, 1, twice).misfit == pytest.approx(0.3 / np.hypot(1, 0.3))


@pytest.mark.parametrize("time", [0.0, -1e-6, math.nan, math.inf])
def test_solves_without_a_time_are_left_out(time):
    """A clock may not resolve a step, and no step may be whole."""
    work = {"solve": {"flop": 2.0}}
    found = fitted(("flop",), 1, [(work, 1.0), (work, time)])
    assert found.seconds == pytest.approx({"flop": 0.5}) and found.misfit < 1e-9


def test_a_disturbed_solve_does_not_fit():
    works = [{"solve": {"flop": float(count)}} for count in (1, 2, 3, 4, 5, 6)]
    times = np.array([1.0, 2, 3, 4, 5, 6])
    assert fitted(("flop",), 1, zip(works, times, strict=True)).misfit < 1e-9
    times[:3] *= 30
    assert fitted(("flop",), 1, zip(works, times, strict=True)).misfit > LARGEST_MISFIT


TABLES = {
    "problem": (problem_time, problem_time.problem_rates),
    "pose-graph": (pose_graph_time, pose_graph_time.pose_graph_rates),
    "factor-graph": (
        factor_graph_time,
        lambda _, **options: factor_graph_time.factor_graph_rates(**options),
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_each_table_has_a_file_of_its_own(monkeypatch, cache, name):
    table, rates_of = TABLES[name]
    calls = []
    made = Rates(num_threads=1, seconds=dict.fromkeys(table.FEATURES, 1e-9))
    monkeypatch.setattr(table, "calibrate", lambda count: calls.append(count) or made)
    assert rates_of(1) == rates_of(1) == made
    assert rates_of(1, recalibrate=True) == made
    assert calls == [1, 1]
    assert [path.name.partition("-rates-")[0] for path in (cache / "bundle").iterdir()] == [name]


def test_a_calibration_without_memory_says_so_and_nothing_of_its_solvers(monkeypatch):
    """A solve refuses what does not fit, by the name of an option that nobody gave."""

    def refuse(*_arguments):
        raise bundle.InputError("linear_solver_type: DENSE_SCHUR needs 79.9 MB for its factor")

    monkeypatch.setattr(problem_time._core, "solve", refuse)
    with pytest.raises(MemoryError, match="rates") as error:
        problem_time.problem_rates(1)
    assert "DENSE_SCHUR" not in str(error.value)


def test_calibration_of_this_machine():
    """Right in kind; a machine that does much else at the time gets the same attempts as a user."""
    rates = problem_time.problem_rates(1)
    assert rates.misfit <= LARGEST_MISFIT
    seconds = rates.seconds
    assert set(seconds) == set(problem_time.FEATURES)
    assert all(0 <= value < 1 for value in seconds.values())
    # One thread has no threads; each of these makes up most of the time of some solve.
    assert seconds["threaded_flop"] == seconds["threaded_entry"] == 0
    assert min(seconds[name] for name in ("flop", "reduced_byte", "ceres_product")) > 0
