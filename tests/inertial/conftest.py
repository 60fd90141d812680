"""Fixtures of the tests of visual-inertial odometry."""

from __future__ import annotations

import pytest

from bundle.inertial.tracking import sequence_axes
from tests.inertial.once import compute_once


@pytest.fixture(autouse=True)
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute rotations of tracks and linear starts of a flight once."""
    compute_once(monkeypatch)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer spans: enough here, and quick."""
    monkeypatch.setattr(sequence_axes, "SPANS", 3)
