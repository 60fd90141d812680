"""Rules about cameras, images and points: fixed, prior, bounds, share, ratio.

Names are imported on first use: an adjustment with resolved rules needs none of them.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from bundle.solving.constraints import rule_list

    return getattr(rule_list, name)
