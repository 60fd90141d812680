"""Rates of this machine: measured, kept, read again, measured again where what was kept is bad."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

import bundle
from bundle.planning.inspection import machine_rates as kept
from bundle.planning.inspection.machine_rates import cache_path, machine_rates
from bundle.planning.inspection.rates import FactorRate, implausible
from tests import made_up_machine

RATES = dataclasses.replace(made_up_machine.RATES, dense_threaded=made_up_machine.CORE)


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def calibrations(monkeypatch):
    """Numbers of threads of each calibration, replaced by one that takes no time."""
    asked = []

    def fake(num_threads):
        asked.append(num_threads)
        return dataclasses.replace(RATES, num_threads=num_threads)

    monkeypatch.setattr(kept, "calibrate", fake)
    return asked


def test_measured_once_for_each_number_of_threads(calibrations, cache):
    first = machine_rates(1)
    assert machine_rates(1) == first
    assert machine_rates(2).num_threads == 2
    assert calibrations == [1, 2]
    assert cache_path(1).parent == cache / "bundle"


def test_recalibrate(calibrations):
    machine_rates(1)
    machine_rates(1, recalibrate=True)
    assert calibrations == [1, 1]


@pytest.mark.parametrize(
    "content",
    ["", "{", "[]", "null", '{"num_threads": 1}', "bad", "nan", "negative"],
)
def test_a_bad_file_is_replaced(calibrations, content):
    good = dataclasses.asdict(RATES)
    if content == "bad":
        content = json.dumps({**good, "dense": 3})
    elif content == "nan":
        content = json.dumps({**good, "fused_pair": math.nan})
    elif content == "negative":
        content = json.dumps({**good, "fused_pair": -1.0})
    cache_path(1).parent.mkdir()
    cache_path(1).write_text(content)
    assert machine_rates(1) == RATES
    assert calibrations == [1]
    assert machine_rates(1) == RATES
    assert calibrations == [1]


def test_without_a_place_to_keep_them(calibrations, monkeypatch, cache):
    (cache / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "file"))
    assert machine_rates(1) == RATES
    assert machine_rates(1) == RATES
    assert calibrations == [1, 1]


def test_a_relative_cache_is_ignored(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_path(1).parent == tmp_path / "home" / ".cache" / "bundle"


def test_instruction_sets_have_rates_of_their_own(monkeypatch):
    usual = cache_path(1)
    monkeypatch.setenv("BUNDLE_INSTRUCTION_SET", "baseline")
    assert cache_path(1) != usual


DISTURBED = {
    "dense": {"dense": FactorRate(flops_per_second=1e-12, seconds_per_entry=0.0)},
    "ceres_evaluation": {"ceres_evaluation": 1e-15},
    "fused_observation": {"fused_observation": 1e-12},
    "fused_pair": {"fused_pair": 0.0},
    "reduced_bytes_per_second": {"reduced_bytes_per_second": 1e14},
    "dense_threaded": {"dense_threaded": FactorRate(flops_per_second=1e12, seconds_per_entry=0.0)},
    "ceres_elimination": {"ceres_elimination": 0.1},
}


@pytest.mark.parametrize("name", DISTURBED)
def test_what_cannot_be_is_named(name):
    rates = dataclasses.replace(RATES, num_threads=2)
    assert implausible(rates) == ()
    assert name in implausible(dataclasses.replace(rates, **DISTURBED[name]))


def test_rates_must_fit_each_other():
    rates = dataclasses.replace(RATES, num_threads=2)
    slow = FactorRate(flops_per_second=0.4 * 1e10, seconds_per_entry=0.0)
    fast = FactorRate(flops_per_second=3.1 * 1e10, seconds_per_entry=0.0)
    for threaded in (slow, fast):
        off = dataclasses.replace(rates, dense_threaded=threaded)
        assert implausible(off) == ("dense_threaded",)
    for share in (0.6, 1.0, 2.9):
        threaded = FactorRate(flops_per_second=share * 1e10, seconds_per_entry=0.0)
        assert implausible(dataclasses.replace(rates, dense_threaded=threaded)) == ()
    off = dataclasses.replace(rates, fused_observation=9e-5)
    assert implausible(off) == ("ceres_evaluation",)


@pytest.mark.parametrize("disturbed", [1, 2, 3])
def test_a_disturbed_calibration_is_repeated_and_never_kept(monkeypatch, disturbed):
    good = dataclasses.replace(RATES, num_threads=2)
    bad = dataclasses.replace(good, ceres_evaluation=1e-15)
    worse = dataclasses.replace(bad, fused_observation=1e-12)
    answers = [*[worse, bad, worse][:disturbed], good]
    asked = iter([*answers, good, good])
    monkeypatch.setattr(kept, "calibrate", lambda _: next(asked))
    assert machine_rates(2) == (good if disturbed < 3 else bad)
    assert cache_path(2).exists() == (disturbed < 3)
    assert machine_rates(2) == good


def test_kept_rates_that_cannot_be_are_measured_again(calibrations):
    cache_path(2).parent.mkdir()
    bad = dataclasses.replace(RATES, num_threads=2, ceres_evaluation=1e-15)
    cache_path(2).write_text(json.dumps(dataclasses.asdict(bad)))
    assert machine_rates(2).ceres_evaluation == RATES.ceres_evaluation
    assert calibrations == [2]


@pytest.mark.parametrize(
    "what", ["_processor", "_blas", "hardware_threads", "__version__", "CERES_VERSION", "node"]
)
def test_the_key_holds_what_rates_depend_on(monkeypatch, what):
    usual = cache_path(1)
    assert cache_path(1) == usual
    if what in ("_processor", "_blas"):
        monkeypatch.setattr(kept, what, lambda: ("another",))
    elif what == "node":
        monkeypatch.setattr(kept.platform, "node", lambda: "another")
    elif what == "hardware_threads":
        monkeypatch.setattr(kept._core, what, lambda: 1000)
    else:
        monkeypatch.setattr(kept._core, what, "another")
    assert cache_path(1) != usual


def test_the_blas_that_is_loaded_is_found():
    assert any("blas" in entry for entry in kept._blas())


def test_a_calibration_without_memory_says_so_and_nothing_of_its_solvers(monkeypatch):
    """A solve refuses what does not fit, by the name of an option that nobody gave."""

    def refuse(*_arguments):
        raise bundle.InputError("linear_solver_type: DENSE_SCHUR needs 79.9 MB for its factor")

    monkeypatch.setattr(kept._core, "solve", refuse)
    with pytest.raises(MemoryError, match="rates") as error:
        machine_rates(1)
    assert "DENSE_SCHUR" not in str(error.value)


def test_calibration_of_this_machine():
    """Right in kind; a machine that does much else at the time gets the same attempts as a user."""
    rates = machine_rates(1)
    assert implausible(rates) == ()
    assert rates.dense == rates.dense_threaded
    for value in dataclasses.asdict(rates).values():
        for number in value.values() if isinstance(value, dict) else (value,):
            assert number >= 0
            assert math.isfinite(number)
