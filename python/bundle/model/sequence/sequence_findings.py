"""Problems found in a sequence: gaps, saturated samples, tracks with one view."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.model.sequence.sequence import Place, Sequence

__all__ = ["SequenceFinding", "sequence_findings"]

Array = NDArray[np.float64]

GAP = 2.5  # a longer interval between samples, in sampling periods, counts as a gap
LONGEST_GAP = 0.1  # s; integration across longer gaps is unreliable
SATURATED_RUN = 4  # number of consecutive samples equal to the largest value of an axis
SATURATED_SIGMAS = 3.0  # distance from the mean, to exclude a quantised sensor at rest
FASTEST = math.radians(2000)  # rad/s: the widest range of usual gyroscopes
ONE_VIEW = 0.5  # fraction of tracks with one view from which a finding is reported


@dataclass(frozen=True)
class SequenceFinding:
    """A finding in a sequence.

    Attributes:
        kind: "imu gap", "image gap", "saturated", "one view", "no samples", "rate".
        sentence: description with file and line, or with the row.
        count: number of occurrences.
        is_fatal: True if odometry would give a wrong trajectory.
    """

    kind: str
    sentence: str
    count: int
    is_fatal: bool = False


def sequence_findings(
    sequence: Sequence, imu_place: Place, track_place: Place
) -> tuple[SequenceFinding, ...]:
    """Return the findings; ``imu_place`` and ``track_place`` convert a row to text."""
    findings: list[SequenceFinding] = []
    stamps = sequence.imu_timestamps_ns
    _imu_gaps(sequence, imu_place, findings)
    _saturated(sequence, imu_place, findings)
    fast = np.flatnonzero(np.linalg.norm(sequence.gyro, axis=1) > FASTEST)
    if len(fast):
        row = int(fast[0])
        findings.append(
            SequenceFinding(
                "rate",
                f"{imu_place(row)}: expected an angular rate in rad/s, found "
                f"{np.linalg.norm(sequence.gyro[row]):.4g}, more than 2000 degrees/s: "
                "units of degrees?",
                len(fast),
            )
        )
    images = sequence.image_timestamps_ns
    outside = np.flatnonzero((images < stamps[0]) | (images > stamps[-1]))
    if len(outside):
        count = len(np.unique(images[outside]))
        findings.append(
            SequenceFinding(
                "no samples",
                f"{track_place(int(outside[0]))}: {plural(count, 'image')} before the first IMU "
                "sample or after the last",
                count,
            )
        )
    _tracks(sequence, track_place, findings)
    return tuple(findings)


def _imu_gaps(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    stamps = sequence.imu_timestamps_ns
    step = np.diff(stamps)
    gaps = np.flatnonzero(step > GAP * np.median(step))
    if not len(gaps):
        return
    images = sequence.image_timestamps_ns
    inside = (stamps[gaps] < images[-1]) & (stamps[gaps + 1] > images[0])
    long = gaps[(step[gaps] > 1e9 * LONGEST_GAP) & inside]
    longest = int(gaps[np.argmax(step[gaps])])
    worst = int(long[0]) if len(long) else longest
    findings.append(
        SequenceFinding(
            "imu gap",
            f"{place(worst + 1)}: expected an IMU sample every {1e-6 * np.median(step):.3g} ms, "
            f"found a gap of {1e-9 * step[worst]:.3g} s",
            len(gaps),
            is_fatal=len(long) > 0,
        )
    )


def _saturated(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    """Find runs of samples equal to the largest value of an axis: the sensor's range ends there."""
    rows = []
    for values in (*sequence.gyro.T, *sequence.accel.T):
        spread = float(values.std())
        for limit in (values.max(), values.min()):
            if abs(limit - values.mean()) < SATURATED_SIGMAS * spread or spread == 0:
                continue
            at = np.flatnonzero(values == limit)
            if len(at) < SATURATED_RUN:
                continue
            runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
            rows += [row for run in runs if len(run) >= SATURATED_RUN for row in run.tolist()]
    if rows:
        findings.append(
            SequenceFinding(
                "saturated",
                f"{place(min(rows))}: {plural(len(set(rows)), 'IMU sample')} at the end of the "
                "sensor's range, the same value again and again",
                len(set(rows)),
            )
        )


def _tracks(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    stamps, begin = sequence.frames()
    step = np.diff(stamps)
    if len(step):
        gaps = np.flatnonzero(step > GAP * np.median(step))
        if len(gaps):
            worst = int(gaps[np.argmax(step[gaps])])
            findings.append(
                SequenceFinding(
                    "image gap",
                    f"{place(int(begin[worst + 1]))}: expected an image every "
                    f"{1e-6 * np.median(step):.3g} ms, found a gap of {1e-9 * step[worst]:.3g} s",
                    len(gaps),
                )
            )
    _, first, views = np.unique(sequence.track_ids, return_index=True, return_counts=True)
    single = views == 1
    if single.mean() > ONE_VIEW:
        findings.append(
            SequenceFinding(
                "one view",
                f"{place(int(first[single].min()))}: {int(single.sum())} of {len(views)} tracks "
                "have one view, and say nothing of depth",
                int(single.sum()),
            )
        )
