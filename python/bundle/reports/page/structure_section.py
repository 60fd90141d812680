"""Structure of the block: track lengths, ray angles, co-visibility."""

from __future__ import annotations

from bundle.analysis.statistics.description import Description
from bundle.base.words import number, plural
from bundle.figures.matplotlib.covisibility_graph import covisibility_graph
from bundle.figures.track_statistics import TrackStatistics, angle_figure, length_figure
from bundle.model.problem import Problem
from bundle.reports.page.matrices import covisibility
from bundle.reports.page.page import tag
from bundle.reports.page.svg import grid
from bundle.reports.page.table import table

__all__ = ["structure_section"]

MOST_EDGES = 1500


def structure_section(
    problem: Problem, description: Description, tracks: TrackStatistics
) -> list[str]:
    """Return the sections on tracks and on co-visibility."""
    rows = [
        [name, *(number(getattr(of, kind)) for kind in ("min", "median", "mean", "max"))]
        for name, of in (
            ("observations per point", description.track_length),
            ("observations per image", description.observations_per_image),
        )
    ]
    graph = description.covisibility
    pieces = plural(len(graph.component_sizes), "connected piece")
    sizes = ", ".join(f"{size:,}" for size in graph.component_sizes[:5])
    more = ", ..." if len(graph.component_sizes) > 5 else ""
    words = f"{pieces} of images that share points: {sizes}{more} images." if sizes else "None."
    return [
        tag("h2", "Tracks and angles", id="tracks"),
        table(["", "min", "median", "mean", "max"], rows),
        grid([length_figure(tracks, int(description.track_length.max)), angle_figure(tracks)]),
        tag("h2", "Co-visibility", id="covisibility"),
        tag("p", f"{words} The stronger an edge, the more points its images share.",
            class_="quiet"),
        covisibility(covisibility_graph(problem, MOST_EDGES)),
    ]  # fmt: skip
