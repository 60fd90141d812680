"""Result of a check of factors: the mistakes with factor, variables, rows and columns.

A mistake is usually one of the code and occurs in every factor with this code. Findings of the same
kind in the same coordinates of factors of one kind are therefore combined.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.tables import Block, columns, facts, notes, render
from bundle.base.words import plural
from bundle.checking.evidence import Finding
from bundle.checking.gradient_report import STYLES, GradientReport, Offender, worst_entries

SHOWN = 10  # number of findings in the repr; printing a check shows all


class Member(NamedTuple):
    """Checked factor: kind, keys, and columns as (name, position of its variable, coordinate)."""

    kind: int
    label: str
    keys: tuple[str, ...]
    columns: tuple[tuple[str, int, str], ...]


@dataclass(frozen=True)
class FactorFinding:
    """A mistake in factors of one kind."""

    kind: str  # signature, one of ``bundle.checking.classify.MISTAKES``
    sentence: str  # explanation, with factor, variables, rows and columns
    factor: str  # name of the first factor with the mistake
    keys: tuple[str, ...]  # its variables whose derivatives are wrong
    columns: tuple[str, ...]  # names of the wrong columns
    rows: tuple[int, ...]  # indices of the wrong rows
    error: float  # largest relative error
    ratio: float | None  # analytic / correct, if this ratio is constant
    num_wrong: int  # number of factors with this mistake
    num_checked: int  # number of checked factors of this kind


@dataclass(frozen=True)
class FactorKind:
    """Verdict on the factors with the same code and the same manifolds."""

    name: str  # class of the factors, and the name of a function
    verdict: str  # "correct", "wrong" or "undecided": the worst of its factors
    num_checked: int  # number of checked factors
    num_wrong: int  # number of factors with a wrong Jacobian
    num_undecided: int  # number of factors without a verdict
    max_error: float  # largest relative error


@dataclass(frozen=True, eq=False, repr=False)
class FactorCheck(Displayed):
    """Result of a check of factors. True if every Jacobian is right."""

    reports: Mapping[str, GradientReport]  # one report per checked factor, by its name in the graph
    members: Mapping[str, Member]  # kind and columns of each checked factor, by its name
    num_factors: int  # number of factors of the graph

    @property
    def ok(self) -> bool:
        """True if the verdict is "correct"."""
        return self.verdict == "correct"

    @property
    def verdict(self) -> str:
        """Worst verdict of the factors: "wrong", "undecided" or "correct"."""
        return _worst({report.verdict for report in self.reports.values()})

    def __bool__(self) -> bool:
        return self.ok

    @property
    def wrong(self) -> dict[str, GradientReport]:
        """Reports of the factors with a wrong Jacobian."""
        return self._with_verdict("wrong")

    @property
    def undecided(self) -> dict[str, GradientReport]:
        """Reports of the factors without a verdict."""
        return self._with_verdict("undecided")

    @property
    def num_checked(self) -> int:
        """Number of checked factors."""
        return len(self.reports)

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of all findings; {"correct"} without findings."""
        return frozenset(found.kind for found in self.findings) or frozenset({"correct"})

    @cached_property
    def findings(self) -> tuple[FactorFinding, ...]:
        """Mistakes, and parameters without a verdict; wrong ones first, then by error."""
        alike: dict[Hashable, list[tuple[str, Finding]]] = {}
        for name, report in self.reports.items():
            member = self.members[name]
            places = {column: (b, coordinate) for column, b, coordinate in member.columns}
            for found in report.findings:
                where = tuple(places.get(column) for column in found.columns)
                alike.setdefault((member.kind, found.kind, where), []).append((name, found))
        combined = [self._combined(same) for same in alike.values()]
        return tuple(sorted(combined, key=lambda one: (one.kind == "undecided", -one.error)))

    @property
    def groups(self) -> tuple[FactorKind, ...]:
        """Verdict on each kind of factor."""
        names: dict[int, list[str]] = {}
        for name, member in self.members.items():
            names.setdefault(member.kind, []).append(name)
        return tuple(self._kind(same) for same in names.values())

    @property
    def worst(self) -> tuple[Offender, ...]:
        """Entries with the largest errors, one per entry of a kind; the place names the factor."""
        found: dict[Hashable, Offender] = {}
        for name, report in self.wrong.items():
            member = self.members[name]
            places = {column: where for column, *where in member.columns}
            details = {"factor": name, "keys": member.keys}
            for entry in report.worst:
                if entry.error <= report.tolerance:
                    continue
                where = member.kind, *places[entry.parameter], entry.residual
                if where not in found or found[where].error < entry.error:
                    found[where] = replace(entry, place=name, details=details)
        return tuple(sorted(found.values(), key=lambda entry: -entry.error)[:SHOWN])

    def _combined(self, same: list[tuple[str, Finding]]) -> FactorFinding:
        name, found = max(same, key=lambda entry: entry[1].error)
        member = self.members[name]
        of = {column: member.keys[b] for column, b, _ in member.columns}
        keys = tuple(dict.fromkeys(of[column] for column in found.columns if column in of))
        count = sum(other.kind == member.kind for other in self.members.values())
        rows = sorted({row for _, other in same for row in other.rows})
        where = f"row{'s' if len(rows) > 1 else ''} {', '.join(map(str, rows))}; " if rows else ""
        return FactorFinding(
            kind=found.kind,
            sentence=f"{name}: {found.sentence} ({where}in {len(same)} of "
            f"{plural(count, 'checked factor')} of this kind)",
            factor=name,
            keys=keys or member.keys,
            columns=found.columns,
            rows=tuple(rows),
            error=found.error,
            ratio=found.factor,
            num_wrong=len(same),
            num_checked=count,
        )

    def _kind(self, names: list[str]) -> FactorKind:
        reports = [self.reports[name] for name in names]
        given = [report.verdict for report in reports]
        errors = (group.max_error for report in reports for group in report.groups)
        return FactorKind(
            self.members[names[0]].label,
            _worst(set(given)),
            len(names),
            given.count("wrong"),
            given.count("undecided"),
            max(errors, default=0.0),
        )

    def _with_verdict(self, verdict: str) -> dict[str, GradientReport]:
        return {name: r for name, r in self.reports.items() if r.verdict == verdict}

    def __str__(self) -> str:
        if self.ok:
            return self._display().title
        return render(*explanation(self)).rstrip("\n")

    def _display(self) -> Display:
        shown = tuple(("finding", found.sentence) for found in self.findings[:SHOWN])
        more = len(self.findings) - SHOWN
        return Display(
            title=f"FactorCheck: {outcome(self)}",
            facts=(*shown, *((("", f"and {more} more"),) if more > 0 else ())),
        )


def outcome(check: FactorCheck) -> str:
    """Return the verdict in one sentence."""
    checked = plural(check.num_checked, "factor")
    if check.num_checked < check.num_factors:
        checked = f"{check.num_checked} checked factors of {check.num_factors}"
    if not check.num_checked:
        return "Nothing to check."
    if check.verdict == "wrong":
        found = sum(one.kind != "undecided" for one in check.findings)
        return (
            f"WRONG: {plural(found, 'finding')} in {len(check.wrong)} of {checked}, the worst "
            "first."
        )
    if check.verdict == "undecided":
        return (
            f"UNDECIDED: no mistake found, but the accuracy of the reference is not sufficient "
            f"for {len(check.undecided)} of {checked}."
        )
    tolerance = next(iter(check.reports.values())).tolerance
    return f"Correct: all Jacobians of {checked} agree with the reference to {tolerance:g}."


def explanation(check: FactorCheck) -> list[Block | str]:
    """Return the verdict, the findings, and tables of errors."""
    return [facts([("verdict", outcome(check))]), *mistakes(check), *measurements(check)]


def mistakes(check: FactorCheck) -> list[Block | str]:
    """Return the findings."""
    return notes((one.sentence for one in check.findings), style=STYLES[check.verdict])


def measurements(check: FactorCheck) -> list[Block | str]:
    """Return tables of the kinds of factors, and of the worst entries."""
    return [block for table in _tables(check) for block in ("", table)]


def kind_rows(check: FactorCheck) -> list[list[str]]:
    """Return the cells of a table with a row for each kind of factors."""
    return [
        [
            kind.name,
            kind.verdict,
            f"{kind.max_error:.1e}",
            str(kind.num_checked),
            str(kind.num_wrong),
            str(kind.num_undecided),
        ]
        for kind in check.groups
    ]


def _tables(check: FactorCheck) -> Iterator[Block]:
    if not check.num_checked:
        return
    head = ("factors", "verdict", "max error", "checked", "wrong", "undecided")
    yield columns(head, kind_rows(check), left=2)
    if check.verdict == "wrong":
        yield worst_entries(check.worst)


def _worst(found: set[str]) -> str:
    return next((name for name in ("wrong", "undecided") if name in found), "correct")
