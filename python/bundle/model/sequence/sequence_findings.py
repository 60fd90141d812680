"""Problems found in a sequence: gaps, bad samples, tracks with one view."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.model.sequence.sequence import Place, Sequence

Array = NDArray[np.float64]

OTHER_RATE = 1.5  # ratio of calibrated and measured rate; clocks differ by less than 1 %
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
        kind: "imu gap", "image gap", "imu rate", "frozen", "zero", "repeated", "saturated",
            "spike", "one view", "no samples", "noise", "rate".
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
    _calibration(sequence, findings)
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


def _calibration(sequence: Sequence, findings: list[SequenceFinding]) -> None:
    """Compare stated rate and noise with samples; those of a simulation may have no noise."""
    noise, rate = sequence.calibration.noise, sequence.calibration.imu_rate
    period = 1e-9 * np.median(np.diff(sequence.imu_timestamps_ns))
    if not 1 / OTHER_RATE < rate * period < OTHER_RATE:
        sentence = (
            f"calibration: imu_rate: expected about {1 / period:.3g} Hz, the rate of the samples, "
            f"found {rate:.3g} Hz: are samples missing?"
        )
        findings.append(SequenceFinding("imu rate", sentence, 1))
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
                    + ("with this noise the IMU has no influence" if is_large else "too certain"),
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
    worst = int(long[0] if len(long) else gaps[np.argmax(step[gaps])])
    sentence = (
        f"{place(worst + 1)}: expected an IMU sample every {1e-6 * np.median(step):.3g} ms, "
        f"found a gap of {1e-9 * step[worst]:.3g} s: {_remedy(not len(long))}"
    )
    findings.append(SequenceFinding("imu gap", sentence, len(gaps), is_fatal=len(long) > 0))


def _remedy(is_short: bool) -> str:
    return "bridged with more uncertainty" if is_short else "too long to be bridged"


_NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}
_BAD = {
    "frozen": "{sensors} repeated one sample for {seconds:.3g} s",
    "zero": "{sensors} was 0 on all axes for {seconds:.3g} s",
    "repeated": "{sensors} repeated {seconds:.3g} s of earlier samples",
    "saturated": "{samples} of the {sensors} at the end of the sensor's range, the same value "
    "again and again",
    "spike": "{sensors} jumped by {size:.3g} and back",
}


def _bad_samples(sequence: Sequence, place: Place, findings: list[SequenceFinding]) -> None:
    """Report stretches of invalid samples; constant samples at rest are valid."""
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
            sentence = (
                f"{place(int(begin[worst + 1]))}: expected an image every "
                f"{1e-6 * np.median(step):.3g} ms, found a gap of {1e-9 * step[worst]:.3g} s"
            )
            findings.append(SequenceFinding("image gap", sentence, len(gaps)))
    _, first, views = np.unique(sequence.track_ids, return_index=True, return_counts=True)
    single = views == 1
    if single.mean() > ONE_VIEW:
        findings.append(
            SequenceFinding(
                "one view",
                f"{place(int(first[single].min()))}: {int(single.sum())} of {len(views)} tracks "
                "have one view, which does not determine depth",
                int(single.sum()),
            )
        )


# Stretches of IMU samples that are no measurements: frozen, zero, repeated, clipped, or a spike.
#
# frozen, zero
#     A sensor repeats all three axes. Noise makes this improbable: with a share p of repeated
#     samples elsewhere in n samples, a run of r repetitions is expected n p^r times.
#
# repeated
#     A block of rows is written twice. Two of n samples are equal with the probability
#     q = sum c (c - 1) / n^2, with the counts c of equal samples, so that a run of r samples that
#     equal those at one distance before is expected at most n^2 q^r times. A run longer than this
#     distance shows the period of a simulation without noise.
#
# saturated
#     The largest or smallest value of an axis, if it occurs in runs and its distribution piles up
#     there: the last value of a clipped axis is more frequent than the one before it. In an axis
#     that is quantised, but not clipped, it is less frequent.
#
# spike
#     A sample far from the median of its neighbours, relative to the quartiles of these, which five
#     spikes in a row do not move, and of the recording: below 3 in flights at 50 to 200 Hz.
#
# :class:`ImuSlices` treats a stretch as a gap of its sensor, with a larger uncertainty.

LONGEST_BRIDGE = 2.0  # s; over a longer stretch, depths and with them the scale get lost
FROZEN_RUN = 5  # usual runs
FROZEN_EXPECTED = 1e-3  # number of such runs by chance
SATURATED_RUN = 4
PILE = 3  # samples at the last value for one at the value before it
NEIGHBOURS, QUARTILES = 21, (5, 10, 15)
SPIKE_SPREAD, SPIKE_USUAL = 6.0, 4.0  # quartile distances; 99th percentiles of the recording
LEAST_SPIKE = (0.05, 0.5)  # rad/s, m/s^2


class BadStretch(NamedTuple):
    """Rows ``first`` to ``last`` of a sensor ("gyro" or "accel"), and the size of their error."""

    kind: str
    sensor: str
    first: int
    last: int
    size: float = 0.0

    @property
    def is_replaced(self) -> bool:
        """True if interpolation is better than the samples themselves."""
        return self.kind != "saturated"


def bad_stretches(gyro: Array, accel: Array) -> tuple[BadStretch, ...]:
    """Return the bad stretches of samples (n, 3), sorted by row; those of a sensor are disjoint."""
    found: list[BadStretch] = []
    for sensor, values, least in zip(("gyro", "accel"), (gyro, accel), LEAST_SPIKE, strict=True):
        good = np.ones(len(values), bool)
        for first, last in _frozen(values):
            kind = "frozen" if values[first].any() else "zero"
            found.append(BadStretch(kind, sensor, first, last))
            good[first : last + 1] = False
        for first, last in _repeated(values):
            found.append(BadStretch("repeated", sensor, first, last))
            good[first : last + 1] = False
        for first, last, size in _spikes(values, good, least):
            found.append(BadStretch("spike", sensor, first, last, size))
            good[first : last + 1] = False
        for first, last in _saturated(values, good):
            found.append(BadStretch("saturated", sensor, first, last))
    return tuple(sorted(found, key=lambda each: (each.first, each.sensor)))


def is_short(stretch: BadStretch, stamps: NDArray[np.int64]) -> bool:
    """Return True if a stretch is short enough to be bridged whatever it contains."""
    return float(stamps[stretch.last] - stamps[stretch.first]) <= 1e9 * LONGEST_BRIDGE


def is_bridged(stretch: BadStretch, stamps: NDArray[np.int64]) -> bool:
    """Return True for a short stretch, and for clipped rates, which images measure, too."""
    return (stretch.kind, stretch.sensor) == ("saturated", "gyro") or is_short(stretch, stamps)


def runs_of(flags: Array) -> Array:
    """Return the first and last index of each run of true flags (k, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2) - [0, 1]


def _frozen(values: Array) -> list[tuple[int, int]]:
    runs = runs_of((values[1:] == values[:-1]).all(axis=1))
    runs[:, 1] += 1  # of samples, not of steps
    length = runs[:, 1] - runs[:, 0] + 1
    others = len(values) - int(length.sum())  # samples that do not repeat
    usual = float(np.median(np.append(length, np.ones(others)))) if len(values) else 1.0
    long = length >= FROZEN_RUN * usual
    share = float((length[~long] - 1).sum()) / len(values)
    improbable = len(values) * share ** (length - 1.0) < FROZEN_EXPECTED
    return [(int(a), int(b)) for a, b in runs[long & improbable]]


def _repeated(values: Array) -> list[tuple[int, int]]:
    order = np.lexsort(values.T)
    is_equal = (values[order[1:]] == values[order[:-1]]).all(axis=1)
    counts = np.diff(np.flatnonzero(np.concatenate([[True], np.logical_not(is_equal), [True]])))
    share = float((counts * (counts - 1.0)).sum()) / max(len(values), 1) ** 2
    before = np.zeros(len(values), np.int64)  # distance to the last equal sample
    before[order[1:][is_equal]] = np.diff(order)[is_equal]
    runs = runs_of((before[1:] == before[:-1]) & (before[1:] >= FROZEN_RUN))
    runs[:, 1] += 1
    length = runs[:, 1] - runs[:, 0] + 1.0
    if (length > before[runs[:, 1]]).any():
        return []
    improbable = len(values) ** 2 * share**length < FROZEN_EXPECTED
    return [(int(a), int(b)) for a, b in runs[(length >= FROZEN_RUN) & improbable]]


def _saturated(values: Array, good: Array) -> list[tuple[int, int]]:
    clipped = np.zeros(len(values), bool)
    for axis in values.T:
        levels, counts = np.unique(axis[good], return_counts=True)
        if len(levels) < SATURATED_RUN:
            continue
        for end, before in ((-1, -2), (0, 1)):
            if counts[end] < max(SATURATED_RUN, PILE * counts[before]):
                continue
            there = (axis == levels[end]) & good
            if (np.diff(runs_of(there)) + 1 >= SATURATED_RUN).any():
                clipped |= there
    return [(int(a), int(b)) for a, b in runs_of(clipped)]


def _spikes(values: Array, good: Array, least: float) -> list[tuple[int, int, float]]:
    if len(values) < NEIGHBOURS:
        return []
    half = NEIGHBOURS // 2
    padded = np.pad(values, ((half, half), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, NEIGHBOURS, axis=0)
    low, middle, high = np.moveaxis(np.partition(windows, QUARTILES, axis=2)[..., QUARTILES], 2, 0)
    distance = np.linalg.norm(values - middle, axis=1)
    usual = float(np.quantile(distance, 0.99))
    bound = np.maximum(SPIKE_SPREAD * np.linalg.norm(high - low, axis=1), SPIKE_USUAL * usual)
    far = (distance > np.maximum(bound, least)) & good
    return [(int(a), int(b), float(distance[a : b + 1].max())) for a, b in runs_of(far)]
