"""Rigs of several sensors in reports."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from bundle.base.words import number, plural
from bundle.reports.sections import Column, Section, Table
from bundle.solving.parameter_changes import SensorChange

if TYPE_CHECKING:
    from bundle.analysis.statistics.rig_summary import RigSummary

MOST_ROWS = 20
"""Number of listed sensors."""

MOST_SENSORS = 8
"""Number of sensors whose changes are shown."""


SENSORS = (
    Column("sensor", lambda change: f"{change.rig_id}:{change.camera_id}"),
    Column("baseline before", "baseline_before", "{:.6g}".format),
    Column("after", "baseline_after", "{:.6g}".format),
    Column("turned [deg]", "rotation", "{:.3g}".format),
)


def rig_sections(rigs: Sequence[RigSummary]) -> list[Section]:
    """Return the sensors of every rig; empty without rigs."""
    if not rigs:
        return []
    cells = [
        (
            f"{rig.rig_id} ({plural(rig.num_frames, 'frame')})" if index == 0 else "",
            f"{sensor.camera_id}",
            "reference" if sensor.is_reference else number(sensor.baseline),
            str(sensor.num_images),
            str(sensor.num_observations) if sensor.num_observations else "unobserved",
        )
        for rig in rigs
        for index, sensor in enumerate(rig.sensors)
    ]
    head = ("rig", "camera", "baseline", "images", "observations")
    table = Table.of(
        head, cells, keys=2, most=MOST_ROWS,
        others=lambda count: f"and {plural(count, 'more sensor')}; --json FILE lists all",
    )  # fmt: skip
    return [Section(tables=[table])]


def sensor_sections(changes: Sequence[SensorChange]) -> list[Section]:
    """Return the motion of sensors on their rigs; empty if no sensor moved."""
    table = Table(
        SENSORS, changes, most=MOST_SENSORS,
        others=lambda count: f"{plural(count, 'other sensor')} moved less; --json FILE lists all",
    )  # fmt: skip
    return [Section(tables=[table])] if changes else []
