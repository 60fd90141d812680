"""Predictions in reports are those for a made-up machine."""

from tests.inspection.conftest import rates  # noqa: F401
