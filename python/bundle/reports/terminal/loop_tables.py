"""What `bundle refine --loops` says of the closures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import RenderableType

from bundle.base.tables import columns, facts, notes, plural
from bundle.base.words import change

if TYPE_CHECKING:
    from bundle.graphs.loops.loop_closing import LoopClosing

__all__ = ["loops_table"]

MOST_CLOSURES = 10
"""Closures that are shown, the rejected ones first."""


def loops_table(closed: LoopClosing) -> list[RenderableType]:
    """Return what became of the closures, and an empty line."""
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
    table = [
        (
            f"{closure.image_ids[0]} {closure.image_ids[1]}",
            "used" if closure.used else "rejected",
            f"{closure.rotation_before:.3g}",
            f"{closure.rotation_after:.3g}",
            f"{closure.translation_before:.3g}",
            f"{closure.translation_after:.3g}",
            f"{closure.chi2_after:.3g}",
        )
        for closure in order[:MOST_CLOSURES]
    ]
    titles = ("closure", "", "rotation [deg]", "after", "translation", "after", "chi2")
    report: list[RenderableType] = [facts(rows), columns(titles, table, left=2)]
    if len(order) > MOST_CLOSURES:
        others = plural(len(order) - MOST_CLOSURES, "other closure")
        report += notes([f"{others} end nearer; --json FILE lists all"])
    return [*report, ""]
