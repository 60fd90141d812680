"""Result of a triage: causes, what they compare, and differences without effect."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.tabular import Tabular
from bundle.judging.triage.cause_words import TriageCause
from bundle.judging.triage.difference import quotient


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A fact of both solves.

    Attributes:
        name: name of the fact.
        old, new: values; None if unknown.
    """

    name: str
    old: float | str | None
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
