"""Rates of this machine: measured, kept, read again, measured again where what was kept is bad."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest

from bundle.inspection import machine_rates as kept
from bundle.inspection.calibrate import calibrate
from bundle.inspection.machine_rates import cache_path, machine_rates
from tests.inspection.conftest import RATES


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def calibrations(monkeypatch):
    """How many threads were asked for in each calibration, which takes no time."""
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


def test_calibration_of_this_machine():
    """Right in kind: no machine is outside, not even one that does much else at the time."""
    rates = calibrate(1)
    assert 1e6 < rates.dense.flops_per_second < 1e13
    assert rates.dense == rates.dense_threaded
    assert 1e6 < rates.reduced_bytes_per_second < 1e13
    for name, low, high in (
        ("fused_observation", 1e-9, 1e-3),
        ("ceres_evaluation", 1e-8, 1e-2),
        ("fused_step", 1e-7, 10),
        ("ceres_step", 1e-6, 10),
        ("ceres_normal_entry", 1e-10, 1e-4),
    ):
        assert low < getattr(rates, name) < high, name
    for value in dataclasses.asdict(rates).values():
        for number in value.values() if isinstance(value, dict) else (value,):
            assert number >= 0
            assert math.isfinite(number)
