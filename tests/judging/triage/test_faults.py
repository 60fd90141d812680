"""Seeded faults are named, and repeated solves are noise (table of tests.campaigns.triage)."""

import functools

import pytest

from tests.campaigns.triage import NOISE, PAIRS, judge
from tests.campaigns.triage_inputs import Workshop


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


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_silent(name, tmp_path):
    found = judge(Workshop(tmp_path, 0), NOISE[name])
    assert found.causes == ()
    assert found.is_noise
