"""Finding: a fact about a model that its user should act on, and the command to act with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

from bundle.base.records import dataclass

DETAILS = ("duplicate_points",)
"""Kinds that terminals show with --verbose only: they matter little, and no command helps."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A fact about a model that its user should act on.

    Attributes:
        kind: stable name for programs, such as "outliers".
        sentence: the fact with its numbers, in words.
        command: command line to run next; "" if no command helps.
        evidence: numbers behind the sentence, by name.
        is_problem: True if the problem is not determined or not usable as it is.
    """

    kind: str
    sentence: str
    command: str = ""
    evidence: Mapping[str, Any] = field(default_factory=dict)
    is_problem: bool = False
