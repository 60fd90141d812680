"""Loop closures in the report of `bundle refine --loops`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bundle.base.words import change, plural
from bundle.reports.sections import Column, Section, Table

if TYPE_CHECKING:
    from bundle.graphs.loops.loop_closing import LoopClosing

MOST_CLOSURES = 10
"""Number of closures shown, the rejected ones first."""


_short = "{:.3g}".format

CLOSURES = (
    Column("closure", lambda one: f"{one.image_ids[0]} {one.image_ids[1]}"),
    Column("", lambda one: "used" if one.used else "rejected"),
    Column("rotation [deg]", "rotation_before", _short),
    Column("after", "rotation_after", _short),
    Column("translation", "translation_before", _short),
    Column("after", "translation_after", _short),
    Column("chi2", "chi2_after", _short),
)


def loops_section(closed: LoopClosing) -> Section:
    """Return the state of the closures after the solve."""
    graph = f"{plural(closed.num_nodes, 'pose')}, {plural(closed.num_edges, 'edge')}"
    pieces = f", {closed.num_components} pieces" if closed.num_components > 1 else ""
    rows = [
        ("loops", f"{closed.num_used} used, {closed.num_rejected} rejected"),
        ("", f"{graph} between images that share points{pieces}"),
        ("", f"cost of the graph {change(closed.cost_before, closed.cost_after)}"),
    ]
    if closed.has_free_scales:
        least, largest = closed.scale_range
        rows.append(("", f"images scaled by {least:.4g} to {largest:.4g}"))
    if closed.factors:
        kept = plural(len(closed.factors), "closure")
        rows.append(("", f"{kept} of images that share few points kept in bundle adjustment"))
    order = sorted(closed.closures, key=lambda closure: (closure.used, -closure.chi2_after))
    table = Table(CLOSURES, order, left=2, most=MOST_CLOSURES, others=_others)
    return Section(facts=rows, tables=[table])


def _others(count: int) -> str:
    return f"{plural(count, 'other closure')} have smaller errors; --json FILE lists all"
