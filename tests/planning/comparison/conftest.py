"""Parts that comparisons in tests leave out."""

import pytest


@pytest.fixture
def unpredicted(monkeypatch):
    """Leave predictions out: they calibrate the machine, and want a place to keep the rates."""
    monkeypatch.setattr("bundle.planning.comparison.work.predict", lambda *_: {})
