"""How the block hangs together: lengths of tracks, angles of rays, co-visibility."""

from __future__ import annotations

from itertools import pairwise

from bundle.analysis.statistics.description import Description
from bundle.base.words import number, plural
from bundle.figures.matplotlib.covisibility_graph import covisibility_graph
from bundle.figures.track_statistics import TrackStatistics
from bundle.model.problem import Problem
from bundle.reports.page.matrices import covisibility
from bundle.reports.page.page import tag
from bundle.reports.page.svg_charts import bars
from bundle.reports.page.table import table

__all__ = ["structure_section"]

MOST_EDGES = 1500


def structure_section(
    problem: Problem, description: Description, tracks: TrackStatistics
) -> list[str]:
    """Return the sections on tracks and on co-visibility."""
    last = len(tracks.lengths) - 1
    longest = description.track_length.max
    names = [f"{n}" for n in range(last)] + [f"{last} or more" if longest > last else f"{last}"]
    lengths = dict(zip(names, map(float, tracks.lengths.tolist()), strict=True))
    lengths = {name: count for name, count in lengths.items() if count}
    limits = tracks.angle_limits
    bins = [f"below {limits[0]:g}°"]
    bins += [f"{low:g} to {high:g}°" for low, high in pairwise(limits)]
    bins.append(f"{limits[-1]:g} to 90°")
    angles = dict(zip(bins, map(float, tracks.angles.tolist()), strict=True))
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
        tag(
            "div",
            tag("figure", tag("h3", "Points by number of observations, log scale"),
                bars(lengths)),
            tag("figure", tag("h3", "Points by the largest angle of two rays, log scale"),
                bars({name: count for name, count in angles.items() if count})),
            class_="grid",
        ),
        tag("h2", "Co-visibility", id="covisibility"),
        tag("p", f"{words} The stronger an edge, the more points its images share.",
            class_="quiet"),
        covisibility(covisibility_graph(problem, MOST_EDGES)),
    ]  # fmt: skip
