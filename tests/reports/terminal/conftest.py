"""Predictions in reports are those for a made-up machine."""

from tests.planning.inspection.conftest import rates  # noqa: F401
