"""Rules about cameras, images and points: fixed, prior, bounds, share, ratio."""

from bundle.solving.constraints.rule_list import Constraints, rules_of
from bundle.solving.constraints.rules import Bounds, Fixed, Prior, Ratio, Rule, Share, Target

__all__ = [
    "Bounds",
    "Constraints",
    "Fixed",
    "Prior",
    "Ratio",
    "Rule",
    "Share",
    "Target",
    "rules_of",
]
