"""Parts that comparisons in tests leave out."""

import pytest

from tests.planning.inspection.conftest import factor_graph_seconds, pose_graph_rates

__all__ = ["factor_graph_seconds", "pose_graph_rates"]


@pytest.fixture
def unpredicted(monkeypatch):
    """Leave predictions out: they calibrate the machine, and want a place to keep the rates."""
    monkeypatch.setattr("bundle.planning.comparison.work.predict", lambda *_: {})
