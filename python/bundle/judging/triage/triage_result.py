"""Result of a triage: records of causes, and of differences without effect, in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import change, duration, number, plural
from bundle.interface.tabular import Tabular
from bundle.judging.triage.difference import Difference, quotient


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A fact of both solves."""

    name: str  # name of the fact
    old: float | str | None  # None if unknown
    new: float | str | None

    @property
    def ratio(self) -> float | None:
        """New value divided by the old one; None if it is not defined."""
        if isinstance(self.old, str) or isinstance(self.new, str):
            return None
        return 0.0 if self.old and self.new == 0 else quotient(self.new, self.old)


@dataclass(frozen=True, kw_only=True, repr=False)
class Triage(Displayed, Tabular):
    """Comparison of two reports of one input.

    Attributes:
        causes: causes of the difference, in the order of proof; empty if nothing changed beyond
            noise.
        quantities: facts of both solves; in a comparison those of the first method.
        methods: for each cause the compared methods that show it; "" outside comparisons.
        notes: differences without an effect beyond noise, as sentences.
    """

    causes: tuple[TriageCause, ...]
    quantities: tuple[Quantity, ...]
    methods: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...] = ()

    @property
    def is_noise(self) -> bool:
        """True if nothing changed beyond noise."""
        return not self.causes

    @property
    def headline(self) -> str:
        """Verdict in one sentence."""
        if not self.causes:
            return "Nothing changed beyond noise."
        names = ", ".join(cause.cause for cause in self.causes)
        return f"Changed: {names}."

    def asdict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "causes": [
                {
                    "cause": cause.cause,
                    "sentence": cause.sentence,
                    "evidence": {
                        **cause.evidence,
                        **({"methods": named} if (named := self.methods.get(cause.cause)) else {}),
                    },
                }
                for cause in self.causes
            ],
            "quantities": [
                {"name": one.name, "old": one.old, "new": one.new, "ratio": one.ratio}
                for one in self.quantities
            ],
            "notes": list(self.notes),
        }

    def _display(self) -> Display:
        facts = [(cause.cause, cause.sentence) for cause in self.causes]
        facts += [("note", note) for note in self.notes]
        return Display(
            title=f"Triage: {plural(len(self.causes), 'cause')}" if facts else "Triage: noise",
            facts=tuple(facts or [("verdict", self.headline)]),
        )


@dataclass(frozen=True, kw_only=True)
class TriageCause:
    """Cause of a difference.

    Attributes:
        cause: one of ``CAUSES``.
        sentence: the cause with its numbers, in words.
        evidence: old and new values by name.
    """

    cause: str
    sentence: str
    evidence: Mapping[str, Any] = field(default_factory=dict)


def pairs(two: Difference, *names: str) -> dict[str, Any]:
    """Return the known old and new values of facts, as evidence."""
    known = {name: two.pair(name) for name in names}
    return {name: {"old": a, "new": b} for name, (a, b) in known.items() if (a, b) != (None, None)}


def times(ratio: float | None) -> str:
    """Return a ratio in words, such as "34 times as large" or "as before"."""
    if ratio is None:
        return "is unknown"
    if abs(ratio - 1) < 5e-4:
        return "as before"
    return f"{number(ratio)} times as large" if ratio < 10 else f"{ratio:,.0f} times as large"


def arrow(two: Difference, name: str, write: Any = number) -> str:
    """Return a fact of both solves as "4 -> 9"."""
    old, new = two.pair(name)
    return " -> ".join("-" if value is None else write(value) for value in (old, new))


def asked(two: Difference, names: tuple[str, ...]) -> str:
    """Return the change of an option that caused a difference, with a leading semicolon."""
    changed = [(name, two.options[name]) for name in names if name in two.options]
    return "".join(f"; option {name} {word(a)} -> {word(b)}" for name, (a, b) in changed)


def effect(two: Difference) -> str:
    """Return the changes of cost, steps and time in a sentence."""
    old, new = two.pair("final_cost")
    said = []
    if two.cost_changed and old is not None and new is not None:
        said.append(f"cost {change(old, new)}")
    if two.cost_changed and two.ratio("error") is not None:
        said.append(f"position error {arrow(two, 'error')}")
    if two.steps_changed:
        said.append(f"steps {arrow(two, 'steps')}")
    if two.factor_changed:
        said.append(f"flops {arrow(two, 'factor_flops')}")
    if not said or two.time_excess is not None:
        said.append(f"time {arrow(two, 'seconds', duration)}")
    words = ", ".join(said)
    return f"{words[0].upper()}{words[1:]}."


def word(value: Any) -> str:
    """Return the value of an option in lower case, with hyphens."""
    if isinstance(value, float):
        return number(value)
    return str(value).lower().replace("_", "-") if isinstance(value, str) else str(value)
