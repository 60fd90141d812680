"""Seeded faults are named, and repeated solves are noise (table of tests.campaigns.triage)."""

import pytest

from tests.campaigns.triage import NOISE, PAIRS, judge
from tests.campaigns.triage_inputs import Workshop


@pytest.mark.parametrize("name", PAIRS)
def test_a_fault_is_named(name, tmp_path):
    cause, pair = PAIRS[name]
    found = judge(Workshop(tmp_path, 0), pair)
    assert cause in [one.cause for one in found.causes[:2]], found
    assert not found.is_noise


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_silent(name, tmp_path):
    found = judge(Workshop(tmp_path, 0), NOISE[name])
    assert found.causes == ()
    assert found.is_noise
