"""Input section of a report: facts for people; path, format and counts for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.words import contents, format_name, pixels, plural
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.reports.terminal.camera_tables import about_shutter, shutter_fact

if TYPE_CHECKING:
    from bundle.model.pose_graph_arrays import PoseGraph
    from bundle.model.sequence.sequence import Sequence

Facts = list[tuple[str, str]]

IMPORTED = ("source_rmse", "rmse", "notes")
"""Attributes of an import from a file of another program."""


def input_facts(path: str, given: Problem | PoseGraph | None, *, rigs: bool = False) -> Facts:
    """Return path, format and contents of an input; with ``rigs`` also the rigs of a problem.

    None is an object of a Python file.
    """
    if given is None:
        return [("input", f"{shown(path)} (Python)")]
    if not isinstance(given, Problem):
        return [("input", f"{shown(path)} (g2o)"), ("", contents_of(given))]
    return [
        ("input", f"{shown(path)} ({format_name(given.format)})"),
        ("", contents(given)),
        *(("", note) for note in import_notes(given)),
        *(rig_fact(given) if rigs else []),
        *shutter_fact(given),
    ]


def about_input(path: str, given: Problem | PoseGraph | None) -> dict[str, Any]:
    """Return path, format and counts of an input for programs, and the notes on its file."""
    if given is None:
        return {"path": path, "format": "python"}
    if not isinstance(given, Problem):
        return {
            "path": path,
            "format": "g2o",
            "dimension": given.dimension,
            "num_poses": given.num_poses,
            "num_edges": given.num_edges,
            "num_closures": int(given.is_closure.sum()),
            "num_fixed_poses": int(given.fixed.sum()),
            "has_poses": given.has_poses,
            "notes": list(given.notes),
        }
    names = ("num_rigs", "num_frames", "num_sensors") if given.num_frames else ()
    counts = ("num_cameras", "num_images", "num_points", "num_observations", *names)
    source = imported_source(given)
    return {
        "path": path,
        "format": given.format,
        **{name: getattr(given, name) for name in counts},
        **about_shutter(given),
        **({name: getattr(source, name) for name in IMPORTED} if source is not None else {}),
    }


def contents_of(given: Problem | PoseGraph) -> str:
    """Return text such as "16 images, ..." or "12 poses, 17 edges, 6 closures, 1 pose fixed"."""
    if isinstance(given, Problem):
        return contents(given)
    counts = (given.num_poses, given.num_edges, int(given.is_closure.sum()))
    fixed = int(given.fixed.sum())
    words = ", ".join(map(plural, counts, ("pose", "edge", "closure")))
    return words + (f", {plural(fixed, 'pose')} fixed" if fixed else "")


def import_notes(problem: Problem) -> list[str]:
    """Return sentences about the import from a file of another program; () for other problems."""
    source = imported_source(problem)
    if source is None:
        return []
    agreement = (
        f"RMSE {pixels(source.source_rmse)} px by the formula of {format_name(problem.format)}, "
        f"{pixels(source.rmse)} px by COLMAP's."
    )
    return [agreement, *source.notes]


def rig_fact(problem: Problem) -> Facts:
    """Return a fact such as "1 rig of 2 sensors, 26 frames"; empty without rigs."""
    if problem.num_frames == 0:
        return []
    # Import late: most problems have no rigs, and this import takes time.
    from bundle.analysis.statistics.description import rig_summaries

    rigs = rig_summaries(problem)
    counts = [len(rig.sensors) for rig in rigs]
    low, high = min(counts), max(counts)
    sensors = plural(high, "sensor") if low == high else f"{low} to {high} sensors"
    frames = sum(rig.num_frames for rig in rigs)
    return [("rigs", f"{plural(len(rigs), 'rig')} of {sensors}, {plural(frames, 'frame')}")]


def contents_of_sequence(sequence: Sequence) -> str:
    """Return text such as "6001 IMU samples, 601 images, 307 tracks, 13316 observations"."""
    nouns = ("IMU sample", "image", "track", "observation")
    return ", ".join(map(plural, _counts(sequence), nouns))


def about_sequence(path: str, format: str, sequence: Sequence) -> dict[str, Any]:
    """Return path, format and counts of a sequence for programs."""
    names = ("num_imu_samples", "num_images", "num_tracks", "num_observations")
    return {"path": path, "format": format, **dict(zip(names, _counts(sequence), strict=True))}


def _counts(sequence: Sequence) -> tuple[int, int, int, int]:
    tracks = len(np.unique(sequence.track_ids))
    return len(sequence.gyro), sequence.num_frames, tracks, len(sequence.xy)


def written(output: dict[str, str] | None) -> tuple[str, str]:
    """Return the fact about the output; ``output`` is None if nothing was written."""
    if output is None:
        return "output", "nothing was written"
    return "output", f"{shown(output['path'])} ({format_name(output['format'])})"
