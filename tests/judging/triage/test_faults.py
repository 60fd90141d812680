"""Seeded faults are named, and repeated solves are noise (table of tests.campaigns.triage)."""

import functools

import pytest

from tests.campaigns.triage import NOISE, PAIRS, judge
from tests.campaigns.triage_inputs import Workshop
from tests.inertial.once import compute_once


@pytest.fixture(autouse=True)
def once(monkeypatch):
    """Both runs of a flight have the same rotations of tracks and starts."""
    compute_once(monkeypatch)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A workshop that makes each input and each report once: the healthy ones serve all pairs."""
    made = Workshop(tmp_path_factory.mktemp("faults"), 0)
    for name in ("run", "graph", "model", "flight"):
        setattr(made, name, functools.cache(getattr(made, name)))
    return made


@pytest.mark.parametrize("name", PAIRS)
def test_a_fault_is_named(name, workshop):
    cause, pair = PAIRS[name]
    found = judge(workshop, pair)
    assert cause in [one.cause for one in found.causes[:2]], found
    assert not found.is_noise


class Again(Workshop):
    """A workshop whose inputs and first report are those of another one; it solves once more."""

    def __init__(self, folder, first):
        super().__init__(folder, first.seed)
        self._first = first
        self.graph, self.model, self.flight = first.graph, first.model, first.flight

    def run(self, *words):
        run, self._first = self._first.run if self._first else super().run, None
        return run(*words)


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_silent(name, workshop, tmp_path):
    found = judge(Again(tmp_path, workshop), NOISE[name], time_noise=50.0)
    assert found.causes == ()
    assert found.is_noise
