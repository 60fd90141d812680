"""Problems found in a sequence: gaps, bad samples, tracks with one view."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.model.sequence.bad_samples import LONGEST_BRIDGE, bad_stretches, is_bridged
from bundle.model.sequence.sequence import Place, Sequence

Array = NDArray[np.float64]

GAP = 2.5  # a longer interval between samples, in sampling periods, counts as a gap
QUIET = 100  # samples of a span
OVERSTATED, UNDERSTATED = 50.0, 10.0  # ratios; noise models of other programs have up to 40
NOISELESS = 1e-3  # ratio
MOVED = 3.0  # sigmas of an observation; noise alone gives 1.7
FASTEST = math.radians(2000)  # rad/s: the widest range of usual gyroscopes
ONE_VIEW = 0.5  # fraction of tracks with one view from which a finding is reported


@dataclass(frozen=True)
class SequenceFinding:
    """A finding in a sequence.

    Attributes:
        kind: "imu gap", "image gap", "frozen", "zero", "saturated", "spike", "one view",
            "no samples", "noise", "rate".
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
    _noise(sequence, findings)
    _bad_samples(sequence, imu_place, findings)
    is_fast = np.linalg.norm(sequence.gyro, axis=1) > FASTEST
    for each in bad_stretches(sequence.gyro, sequence.accel):
        is_fast[each.first : each.last + 1] &= each.kind != "spike"
    fast = np.flatnonzero(is_fast)
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


def quietest_noise(values: Array, period: float) -> float:
    """Return the white noise density of samples (n, 3) in the quietest of many short spans.

    Second differences of white noise have six times its variance, those of a smooth motion little.
    """
    change = np.diff(values, 2, axis=0)
    spans = len(change) // QUIET
    if not spans:
        return float("nan")
    variances = (change[: spans * QUIET] ** 2).reshape(spans, QUIET, 3).mean(axis=(1, 2)) / 6
    return float(np.sqrt(variances.min() * period))


def _noise(sequence: Sequence, findings: list[SequenceFinding]) -> None:
    """Compare stated noise with samples; those of a simulation without noise say nothing."""
    noise, period = (
        sequence.calibration.noise,
        1e-9 * np.median(np.diff(sequence.imu_timestamps_ns)),
    )
    for name, stated, values in (
        ("gyro_noise_density", noise.gyro_noise_density, sequence.gyro),
        ("accel_noise_density", noise.accel_noise_density, sequence.accel),
    ):
        found = quietest_noise(values, float(period))
        is_large = found > NOISELESS * stated and stated > OVERSTATED * found
        if is_large or found > UNDERSTATED * stated:
            findings.append(
                SequenceFinding(
                    "noise",
                    f"calibration: {name}: expected about {found:.2g}, the noise of the samples "
                    f"where they are quietest, found {stated:.2g}: "
                    + ("with this noise the IMU says nothing" if is_large else "too certain"),
                    1,
                    is_fatal=is_large,
                )
            )


def _imu_gaps(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    stamps = sequence.imu_timestamps_ns
    step = np.diff(stamps)
    gaps = np.flatnonzero(step > GAP * np.median(step))
    if not len(gaps):
        return
    images = sequence.image_timestamps_ns
    inside = (stamps[gaps] < images[-1]) & (stamps[gaps + 1] > images[0])
    long = gaps[(step[gaps] > 1e9 * LONGEST_BRIDGE) & inside]
    longest = int(gaps[np.argmax(step[gaps])])
    worst = int(long[0]) if len(long) else longest
    findings.append(
        SequenceFinding(
            "imu gap",
            f"{place(worst + 1)}: expected an IMU sample every {1e-6 * np.median(step):.3g} ms, "
            f"found a gap of {1e-9 * step[worst]:.3g} s: {_remedy(not len(long))}",
            len(gaps),
            is_fatal=len(long) > 0,
        )
    )


def _remedy(is_short: bool) -> str:
    return "bridged with more uncertainty" if is_short else "too long to be bridged"


_NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}
_BAD = {
    "frozen": "{sensors} repeated one sample for {seconds:.3g} s",
    "zero": "{sensors} was 0 on all axes for {seconds:.3g} s",
    "saturated": "{samples} of the {sensors} at the end of the sensor's range, the same value "
    "again and again",
    "spike": "{sensors} jumped by {size:.3g} and back",
}


def _bad_samples(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    """Report stretches that are no measurements; a constant sensor at rest is none of them."""
    stamps = sequence.imu_timestamps_ns
    found = [
        each
        for each in bad_stretches(sequence.gyro, sequence.accel)
        if each.kind not in ("frozen", "zero")
        or _image_motion(sequence, int(stamps[each.first]), int(stamps[each.last])) > MOVED
    ]
    for kind, text in _BAD.items():
        these = [each for each in found if each.kind == kind]
        if not these:
            continue
        worst = max(these, key=lambda each: (each.last - each.first, each.size))
        sensors = dict.fromkeys(each.sensor for each in these)
        count = len({row for each in these for row in range(each.first, each.last + 1)})
        said = text.format(
            sensors=" and ".join(_NAMES[sensor] for sensor in sensors),
            seconds=1e-9 * float(stamps[worst.last] - stamps[worst.first]),
            samples=plural(count, "IMU sample"),
            size=worst.size,
        )
        after = 1e-9 * float(stamps[worst.first] - stamps[0])
        others = f" ({plural(len(these), 'time')} in all)" if len(these) > len(sensors) else ""
        findings.append(
            SequenceFinding(
                kind,
                f"{place(worst.first)}: {said}, {after:.2f} s after the first sample{others}: "
                f"{_remedy(is_bridged(worst, stamps))}",
                count,
            )
        )


def _image_motion(sequence: Sequence, begin: int, end: int) -> float:
    """Return the median motion of tracks between the images around two times, in sigmas."""
    stamps = np.unique(sequence.image_timestamps_ns)
    first = max(int(np.searchsorted(stamps, begin, "right")) - 1, 0)
    last = min(int(np.searchsorted(stamps, end)), len(stamps) - 1)
    one, other = (
        np.flatnonzero(sequence.image_timestamps_ns == stamp) for stamp in stamps[[first, last]]
    )
    _, a, b = np.intersect1d(
        sequence.track_ids[one], sequence.track_ids[other], return_indices=True
    )
    if not len(a):
        return float("inf")
    calibration = sequence.calibration
    unit = calibration.focal if calibration.camera_model is None else 1.0
    moved = np.linalg.norm(sequence.xy[other[b]] - sequence.xy[one[a]], axis=1)
    return float(np.median(moved)) * unit / calibration.pixel_sigma


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
