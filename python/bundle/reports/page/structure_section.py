"""Structure of the block: track lengths, ray angles, co-visibility."""

from __future__ import annotations

from bundle.analysis.statistics.description import Description
from bundle.base.words import number, plural
from bundle.figures.structure_figures import (
    CovisibilityGraph,
    TrackStatistics,
    angle_figure,
    covisibility_figure,
    length_figure,
)
from bundle.reports.sections import Section, Table


def structure_section(
    description: Description, tracks: TrackStatistics, graph: CovisibilityGraph
) -> Section:
    """Return the section on tracks and co-visibility."""
    rows = [
        [name, *(number(getattr(of, kind)) for kind in ("min", "median", "mean", "max"))]
        for name, of in (
            ("observations per point", description.track_length),
            ("observations per image", description.observations_per_image),
        )
    ]
    longest = description.track_length.max
    sizes = description.covisibility.component_sizes
    listed = ", ".join(f"{size:,}" for size in sizes[:5]) + (", ..." if len(sizes) > 5 else "")
    words = "No image shares a point with another."
    if sizes:
        words = f"{plural(len(sizes), 'connected piece')} of images that share points: {listed}."
    return Section(
        title="Tracks and co-visibility",
        text=[f"{words} The stronger an edge, the more points its images share."],
        tables=[Table.of(["", "min", "median", "mean", "max"], rows)],
        figures=[
            *([length_figure(tracks, int(longest))] if longest > 0 else []),
            *([angle_figure(tracks)] if tracks.angles.any() else []),
            covisibility_figure(graph),
        ],
    )
