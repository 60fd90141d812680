"""Parts that comparisons in tests leave out."""

import pytest


@pytest.fixture
def unpredicted(monkeypatch):
    """Leave predictions out."""
    monkeypatch.setattr("bundle.planning.comparison.work.predict", lambda *_: {})
