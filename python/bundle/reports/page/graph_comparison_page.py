"""Page of a comparison on a graph: recommendation, runs, and their time by phase."""

from __future__ import annotations

import os
from html import escape

from bundle.base.paths import as_path
from bundle.base.words import plural
from bundle.figures.graph_cost_figures import graph_breakdown_figure, graph_time_figure
from bundle.planning.comparison.graph_comparison import GraphComparison
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.section_markup import rendered
from bundle.reports.sections import Section
from bundle.reports.terminal.graph_costs import run_table


def write_graph_comparison(
    found: GraphComparison, path: str | os.PathLike[str], name: str = "", orders_only: bool = False
) -> None:
    """Write a comparison as one self-contained HTML file.

    Args:
        found: the comparison.
        path: path of the file.
        name: name of the graph, for the title.
        orders_only: True if the methods differ in the elimination order alone.

    Raises:
        InputError: the path is a folder, or a path above it is no folder.
        OSError: the file cannot be written.
    """
    usable = [run for run in found.runs if not run.failure]
    figures = [graph_time_figure(found), graph_breakdown_figure(found)] if usable else []
    sections: list[Section | str] = [
        _conditions(found),
        _recommendation(found),
        Section(title="Methods", tables=[run_table(found, orders_only)]),
        Section(title="Time", figures=figures),
    ]
    write_page(as_path(path), f"Solvers compared: {name or 'a graph'}", rendered(sections))


def _conditions(found: GraphComparison) -> str:
    median = f" Times are medians of {found.repeat} solves." if found.repeat > 1 else ""
    words = (
        f"{plural(len(found.runs), 'method')} from one start, each stopped after "
        f"{found.timeout:g} seconds.{median} {found.environment.sentence}"
    )
    return tag("p", escape(words), class_="quiet")


def _recommendation(found: GraphComparison) -> str:
    style = {} if found.recommended is not None else {"class_": "warn"}
    lines = [tag("p", escape(found.reason), **style)]
    if found.command:
        lines.append(tag("pre", tag("code", escape(found.command))))
    lines += [tag("p", escape(sentence), class_="warn") for sentence in found.warnings]
    return tag("div", *lines, class_="recommended")
