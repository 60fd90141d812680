"""Rules about cameras, images and points: fixed, prior, on, bounds, share, ratio.

Names are imported on first use: an adjustment with resolved rules needs none of them.

Written by tools/public_stub.py; do not edit.
"""

from bundle.solving.constraints.rule_list import Constraints as Constraints
from bundle.solving.constraints.rule_list import rules_of as rules_of
from bundle.solving.constraints.rules import Bounds as Bounds
from bundle.solving.constraints.rules import Fixed as Fixed
from bundle.solving.constraints.rules import On as On
from bundle.solving.constraints.rules import Prior as Prior
from bundle.solving.constraints.rules import Ratio as Ratio
from bundle.solving.constraints.rules import Rule as Rule
from bundle.solving.constraints.rules import Share as Share
from bundle.solving.constraints.rules import Target as Target

__all__ = [
    "Bounds",
    "Constraints",
    "Fixed",
    "On",
    "Prior",
    "Ratio",
    "Rule",
    "Share",
    "Target",
    "rules_of",
]
