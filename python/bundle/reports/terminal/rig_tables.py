"""What reports say of rigs of several sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import RenderableType

from bundle.base.tables import columns, notes, number
from bundle.base.words import plural
from bundle.model.problem import Problem
from bundle.solving.sensor_changes import SensorChange

if TYPE_CHECKING:
    from bundle.analysis.statistics.rig_summary import RigSummary

__all__ = ["rig_fact", "rig_table", "sensor_table"]

MOST_ROWS = 20
"""Sensors that are listed."""

MOST_SENSORS = 8
"""Sensors whose changes are shown."""


def rig_fact(problem: Problem) -> list[tuple[str, str]]:
    """Return a fact such as "1 rig of 2 sensors, 26 frames"; nothing where there are no rigs."""
    if problem.num_frames == 0:
        return []
    # Statistics are late to import, and most problems have no rigs.
    from bundle.analysis.statistics.rig_summary import rig_summaries

    rigs = rig_summaries(problem)
    counts = [len(rig.sensors) for rig in rigs]
    low, high = min(counts), max(counts)
    sensors = plural(high, "sensor") if low == high else f"{low} to {high} sensors"
    frames = sum(rig.num_frames for rig in rigs)
    return [("rigs", f"{plural(len(rigs), 'rig')} of {sensors}, {plural(frames, 'frame')}")]


def rig_table(rigs: Sequence[RigSummary]) -> list[RenderableType]:
    """Return the sensors of every rig and an empty line; nothing where there are no rigs."""
    if not rigs:
        return []
    rows = []
    for rig in rigs:
        label = f"{rig.rig_id} ({plural(rig.num_frames, 'frame')})"
        for sensor in rig.sensors:
            rows.append(
                (
                    label,
                    f"{sensor.camera_id}",
                    "reference" if sensor.is_reference else number(sensor.baseline),
                    str(sensor.num_images),
                    str(sensor.num_observations) if sensor.num_observations else "unobserved",
                )
            )
            label = ""
    head = ("rig", "camera", "baseline", "images", "observations")
    report: list[RenderableType] = [columns(head, rows[:MOST_ROWS], left=1, keys=2)]
    if len(rows) > MOST_ROWS:
        report += notes(
            [f"and {plural(len(rows) - MOST_ROWS, 'more sensor')}; --json FILE lists all"]
        )
    return [*report, ""]


def sensor_table(changes: Sequence[SensorChange]) -> list[RenderableType]:
    """Return how sensors moved on their rigs and an empty line; nothing where none did."""
    if not changes:
        return []
    rows = [
        (
            f"{change.rig_id}:{change.camera_id}",
            f"{change.baseline_before:.6g}",
            f"{change.baseline_after:.6g}",
            f"{change.rotation:.3g}",
        )
        for change in changes[:MOST_SENSORS]
    ]
    head = ("sensor", "baseline before", "after", "turned [deg]")
    report: list[RenderableType] = [columns(head, rows)]
    if len(changes) > MOST_SENSORS:
        others = plural(len(changes) - MOST_SENSORS, "other sensor")
        report += notes([f"{others} moved less; --json FILE lists all"])
    return [*report, ""]
