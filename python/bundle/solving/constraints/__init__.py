"""Rules about cameras, images and points: fixed, prior, on, bounds, share, ratio.

Names are imported on first use: an adjustment with resolved rules needs none of them.
"""

from __future__ import annotations

from bundle.base.public_modules import deferred

_DEFERRED = {
    "rule_list": "Constraints rules_of",
    "rules": "Bounds Fixed On Prior Ratio Rule Share Target",
}
__all__, __getattr__, __dir__ = deferred(__name__, _DEFERRED)
