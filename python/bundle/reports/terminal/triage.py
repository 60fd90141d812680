"""Report of `bundle triage`."""

from __future__ import annotations

from bundle.base.words import number
from bundle.errors import shown
from bundle.interface.judging_options import TriageOptions
from bundle.judging.triage.triage_result import Quantity, Triage
from bundle.reports.sections import Column, Report, Section, Table

NAMES = {
    "columns": "columns n",
    "measurements": "residuals",
    "information_nonzeros": "nnz(Lambda)",
    "factor_nonzeros": "nnz(L)",
    "factor_flops": "flops",
    "ordering": "ordering",
    "initial_cost": "cost at the start",
    "final_cost": "cost at the end",
    "steps": "steps",
    "rejected": "rejected steps",
    "least_radius": "smallest radius (1 / lambda)",
    "seconds": "time [s]",
    "num_threads": "threads",
    "error": "position error [m]",
}
"""Names of the quantities in the table."""


def triaged(paths: tuple[str, str], found: Triage, options: TriageOptions) -> Report:
    """Return the report on two reports: causes first, then the quantities side by side."""
    columns = (
        Column("", lambda one: NAMES[one.name]),
        Column("old", lambda one: _word(one.old)),
        Column("new", lambda one: _word(one.new)),
        Column("ratio", _ratio),
    )
    methods = [
        f"{cause.cause}: {', '.join(named)}."
        for cause in found.causes
        if (named := found.methods.get(cause.cause))
    ]
    return Report(
        command="triage",
        headline=[cause.sentence for cause in found.causes] or [found.headline],
        sections=[
            Section(tables=[Table(columns, found.quantities)], notes=found.notes),
            *([Section(notes=methods, is_detail=True)] if methods else []),
        ],
        data={
            "old": {"path": paths[0]},
            "new": {"path": paths[1]},
            "options": options.asdict(),
            **found.asdict(),
        },
    )


def _word(value: float | str | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):
        return shown(value)
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e9 else number(value)


def _ratio(one: Quantity) -> str:
    return "" if one.ratio is None else number(one.ratio)
