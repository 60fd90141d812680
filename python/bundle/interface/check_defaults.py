"""What a check of Jacobians does unless something else is asked for: declared once.

The command line reads this for its flags and its help, without the import of ``bundle.checking``.
"""

from __future__ import annotations

__all__ = ["SAMPLES_PER_IMAGE", "TOLERANCE"]

SAMPLES_PER_IMAGE = 100
"""Observations that are checked of each image."""
TOLERANCE = 1e-7
"""Relative error from which on an entry is wrong."""
