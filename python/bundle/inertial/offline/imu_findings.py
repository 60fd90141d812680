"""Findings about samples, calibration and clocks of an adjustment with an IMU."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.inertial.offline.imu_agreement import (
    DRIFT,
    DRIFT_SIGMAS,
    JITTER,
    JITTER_SHARE,
    LARGE_NOISE,
    Agreement,
    ClockErrors,
    ClockOffset,
)
from bundle.inertial.offline.rotation_map import RotationMap
from bundle.inertial.offline.score_tests import Score
from bundle.model.rigid_motions import quaternion_from_vector, quaternion_multiply
from bundle.model.sequence.sequence_findings import GAP, LONGEST_BRIDGE, UNDERSTATED, BadStretch

Array = NDArray[np.float64]

LOST = 0.01  # share of the samples from which lost ones are a cause
OUTLIERS = 4.0  # variance factor under a quadratic loss from which outliers rule the cost
EXPLAINED = 0.5  # share of a contradiction that a held value, its cause, explains: 0.6 or more
ACCEL = "accelerometer", "m/s^2"
LONG_ARM = 3.0  # distance in metres between camera and IMU from which millimetres are likely

CAUSES = {
    "imu_samples": "samples are no measurements, or lost",
    "camera_from_imu": "camera_from_imu is turned",
    "arm": "the arm of camera_from_imu is wrong",
    "accel_scale": "the scale of the forces is wrong",
    "gyro_scale": "the scale of the rates is wrong",
    "gyro_bias": "the bias of the gyroscope jumps or drifts",
    "accel_bias": "the bias of the accelerometer jumps or drifts",
    "imu_clocks": "the times of images are wrong",
    "imu_noise": "the calibrated noise is wrong",
    "unknown": "camera_from_imu, the clocks, the intrinsics or the noise of the IMU is wrong",
}
"""Causes by the kind of the finding that shows them."""


class ImuFinding(NamedTuple):
    """Finding without its command line."""

    # "imu_contradiction", "imu_samples", "imu_interval", "camera_from_imu", "arm", "accel_scale",
    # "gyro_scale", "gyro_bias", "accel_bias", "imu_clocks" or "imu_noise"
    kind: str
    sentence: str  # the fact with its numbers
    evidence: Mapping[str, Any]  # numbers behind the sentence
    flags: tuple[str, ...] = ()  # flags that the next command adds; none: no command helps
    is_problem: bool = False  # True if the result is not usable


class Evidence(NamedTuple):
    """Evidence on the agreement of images and IMU."""

    agreement: Agreement  # chi2 of the adjustment
    is_converged: bool  # True if its solve converged
    is_quadratic: bool  # True without a robust loss
    rotations: RotationMap  # map between the rotations
    far: tuple[str, str]  # cause of a contradiction, "imu_clocks" or "accel_axes", and its sentence
    held: Callable[[], Score | None]  # value that is held wrongly; called without another cause
    clocks: ClockErrors  # errors of single times
    offset: ClockOffset  # offset of the clocks
    noise: tuple[float, float]  # calibrated noise densities over those of the samples
    quietest: float  # noise of the samples where they are quietest over the calibrated one
    noise_scale: float  # factor for vibration
    camera_from_imu: Array  # (7,)
    bad: Sequence[BadStretch]  # stretches of samples that are no measurements
    stamps: NDArray[np.int64]  # stamps of the samples
    place: Callable[[int], str]  # function that converts a row of the samples to text
    begins: NDArray[np.int64]  # (n,) stamps at the begin of each interval


def imu_findings(known: Evidence) -> tuple[ImuFinding, ...]:
    """Return the findings, the most important first."""
    others = [
        one
        for one in (
            _samples(known), _turned(known), _scaled(known), _times(known), _noise(known),
            _offset(known), _intervals(known),
        )
        if one is not None
    ]  # fmt: skip
    if not _causes(others):
        last = _held(known)
        others = others if last is None else [last, *others]
    first = _contradiction(known, others)
    return tuple(others if first is None else [first, *others])


def _contradiction(known: Evidence, others: Sequence[ImuFinding]) -> ImuFinding | None:
    agreement = known.agreement
    if not agreement.is_contradicted:
        return None
    ratio = agreement.chi2 / agreement.freedom
    kind, cause = known.rotations.cause(known.camera_from_imu)
    arm = float(np.linalg.norm(known.camera_from_imu[4:]))
    too_small = max(1 / (one * known.noise_scale) if one else 0.0 for one in known.noise)
    named = _causes(others)
    if known.is_quadratic and agreement.images_variance > OUTLIERS:
        kind, cause = "outliers", "the images have outliers, and no robust loss was given"
    if not cause:
        kind, cause = known.far
    if not cause and arm > LONG_ARM:
        kind, cause = "arm", f"camera_from_imu has an arm of {arm:.3g} m: is it in millimetres?"
    if not cause and named:
        kind, cause = named[0], CAUSES[named[0]]
    flags: tuple[str, ...] = ("--loss", "cauchy") if kind == "outliers" else ()
    if not cause:
        kind, cause = "unknown", CAUSES["unknown"]
        if too_small > 1:
            kind, cause = "imu_noise", "the samples have more noise than the calibration states"
        scale = known.noise_scale * max(ratio**0.5, too_small)
        flags = ("--imu-noise-scale", f"{scale:.2g}")
        if not known.is_converged:
            kind, cause = "not_converged", "too few steps to find the cause"
            flags = ("--max-iterations", "200")
    worst = int(np.argmax(agreement.interval_chi2))
    row, seconds = _when(known, worst)
    state = "" if known.is_converged else ", and the solve did not converge"
    return ImuFinding(
        "imu_contradiction",
        f"Images and IMU contradict each other: their joint cost is {ratio:.3g} times what their "
        f"noise explains, largest at {seconds:.2f} s ({known.place(row)}){state}: {cause}.",
        {
            "cause": kind, "chi2": agreement.chi2, "freedom": agreement.freedom,
            "bound": agreement.bound, "seconds": seconds, "row": row,
        },
        flags,
        is_problem=True,
    )  # fmt: skip


def _causes(found: Sequence[ImuFinding]) -> list[str]:
    return [one.kind for one in found if one.kind in CAUSES and "offset" not in one.evidence]


def _held(known: Evidence) -> ImuFinding | None:
    agreement = known.agreement
    least = EXPLAINED * agreement.chi2 * max(agreement.images_variance, 1.0)
    found = known.held()
    if found is None or (agreement.is_contradicted and found.gain < least):
        return None
    if found.kind == "camera_from_imu":
        return _turned_by(known, found.x * found.along, found.sigma)
    if found.kind == "gyro_scale":
        return _rates(1 + found.x)
    words = {"accel_scale": _forces, "arm": _arm}.get(found.kind, _bias)
    return words(known, found)


def _forces(_: Evidence, found: Score) -> ImuFinding:
    ratio = 1 + found.x
    return ImuFinding(
        "accel_scale",
        f"The forces of the accelerometer are {ratio:.3f} +- {found.sigma:.1g} times those "
        f"of images and gravity, which moves the positions by {100 * found.movement:.2g} %: its "
        "scale is wrong, and so is the scale of the result.",
        {"ratio": ratio, "ratio_sigma": found.sigma, "movement": found.movement},
    )


def _arm(known: Evidence, found: Score) -> ImuFinding:
    right = known.camera_from_imu[4:] + found.x * found.along
    words = ", ".join(f"{value:.3f}" for value in right)
    return ImuFinding(
        "arm",
        f"The arm of camera_from_imu is off by {100 * abs(found.x):.2g} +- "
        f"{100 * found.sigma:.1g} cm: images and IMU agree best with the translation {words}.",
        {"metres": abs(found.x), "metres_sigma": found.sigma, "translation": right.tolist()},
    )


def _bias(known: Evidence, found: Score) -> ImuFinding:
    row, seconds = _when(known, found.interval)
    duration = 1e-9 * float(known.begins[-1] - known.begins[0])
    sensor, unit = ("gyroscope", "rad/s") if found.kind == "gyro_bias" else ACCEL
    return ImuFinding(
        found.kind,
        f"The bias of the {sensor} changes faster than its random walk: a step of "
        f"{abs(found.x):.2g} +- {found.sigma:.1g} {unit} at {seconds:.2f} s ({known.place(row)}) "
        f"moves the positions by {100 * found.movement:.2g} %. If the sensor warms up, "
        f"{found.kind}_random_walk of {abs(found.x) / duration**0.5:.1g} allows for it.",
        {
            "step": (found.x * found.along).tolist(), "step_sigma": found.sigma,
            "seconds": seconds, "row": row, "movement": found.movement,
        },
    )  # fmt: skip


def _when(known: Evidence, interval: int) -> tuple[int, float]:
    """Return the row of the first sample of an interval, and its seconds since the first row."""
    row = int(np.searchsorted(known.stamps, known.begins[interval]))
    return row, 1e-9 * float(known.begins[interval] - known.stamps[0])


FAULT = ("kind", "sensor", "first_row", "last_row", "num_samples", "seconds")


def sample_faults(
    bad: Sequence[BadStretch], stamps: NDArray[np.int64], place: Callable[[int], str]
) -> tuple[str, list[dict[str, Any]]]:
    """Return the faults of samples in words and as evidence, by kind and sensor."""
    faults: list[dict[str, Any]] = []
    words = []
    for kind, sensor in sorted({(one.kind, one.sensor) for one in bad}):
        rows = [(one.first, one.last) for one in bad if (one.kind, one.sensor) == (kind, sensor)]
        count = sum(last - first + 1 for first, last in rows)
        first, last = rows[0][0], rows[-1][1]
        begin, end = (1e-9 * float(stamps[row] - stamps[0]) for row in (first, last))
        when = f"at {begin:.2f} s" if first == last else f"from {begin:.2f} to {end:.2f} s"
        name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
        words.append(f"{place(first)}: {name} {kind}, {plural(count, 'sample')} {when}")
        values = kind, sensor, first, last, count, begin
        faults.append(dict(zip(FAULT, values, strict=True)))
    return "; ".join(words), faults


def _samples(known: Evidence) -> ImuFinding | None:
    words, faults = sample_faults(known.bad, known.stamps, known.place)
    since = 1e-9 * (known.stamps - known.stamps[0])
    steps = np.diff(since) / np.median(np.diff(since))
    gaps = np.flatnonzero(steps > GAP)
    count = round(float((steps[gaps] - 1).sum()))
    if count > LOST * len(since):
        first, last = int(gaps[0]), int(gaps[-1]) + 1
        when = f"from {since[first]:.2f} to {since[last]:.2f} s"
        gone = f"{known.place(first + 1)}: {plural(count, 'sample')} lost {when}"
        words = f"{gone}; {words}" if words else gone
        values = "lost", "both", first, last, count, float(since[first])
        faults.append(dict(zip(FAULT, values, strict=True)))
    if not faults:
        return None
    return ImuFinding(
        "imu_samples",
        f"Some samples of the IMU are no measurements, or lost: {words}. They are "
        f"treated as gaps, of at most {LONGEST_BRIDGE:g} s.",
        {"faults": faults},
    )


def _turned(known: Evidence) -> ImuFinding | None:
    found = known.rotations
    if not found.is_turned or known.rotations.cause(known.camera_from_imu)[0]:
        return None
    return _turned_by(known, found.turn, math.radians(found.angle_sigma))


def _turned_by(known: Evidence, turn: Array, sigma: float) -> ImuFinding:
    given, by = known.camera_from_imu[None, :4], quaternion_from_vector(turn[None])
    quaternion = quaternion_multiply(given, by)[0]
    angle, spread = math.degrees(float(np.linalg.norm(turn))), math.degrees(sigma)
    words = ", ".join(f"{value:.5f}" for value in quaternion)
    return ImuFinding(
        "camera_from_imu",
        f"The rotation of camera_from_imu is off by {angle:.2f} +- {spread:.1g} "
        f"degrees: the rotations of the images give the quaternion {words}.",
        {"degrees": angle, "degrees_sigma": spread, "quaternion": quaternion.tolist()},
    )


def _scaled(known: Evidence) -> ImuFinding | None:
    found = known.rotations
    is_clipped = any((one.kind, one.sensor) == ("saturated", "gyro") for one in known.bad)
    if is_clipped or not found.is_scaled or found.cause(known.camera_from_imu)[0]:
        return None
    return _rates(1 / found.scale)


def _rates(ratio: float) -> ImuFinding:
    return ImuFinding(
        "gyro_scale",
        f"The rates of the gyroscope are {ratio:.3f} times those of the images: its "
        "scale or the focal length is wrong.",
        {"ratio": ratio},
    )


def _times(known: Evidence) -> ImuFinding | None:
    found = known.clocks
    duration = 1e-9 * float(known.begins[-1] - known.begins[0])
    drifts = abs(found.drift) > DRIFT_SIGMAS * found.drift_sigma
    if drifts and abs(found.drift) * duration > DRIFT:
        return ImuFinding(
            "imu_clocks",
            f"The clocks of camera and IMU drift by {1e6 * found.drift:.3g} +- "
            f"{1e6 * found.drift_sigma:.1g} us per s, {1e3 * found.drift * duration:.3g} ms in "
            "this video.",
            {"drift": found.drift, "drift_sigma": found.drift_sigma},
        )
    if not (found.jitter > JITTER and found.share > JITTER_SHARE):
        return None
    return ImuFinding(
        "imu_clocks",
        f"The clocks of camera and IMU do not agree from image to image: errors of "
        f"{1e3 * found.jitter:.2g} ms of single times explain {100 * found.share:.0f} % of the "
        "difference between the rotations.",
        {"jitter": found.jitter, "share": found.share},
    )


def _offset(known: Evidence) -> ImuFinding | None:
    clock = known.offset
    if not clock.is_clear:
        return None
    return ImuFinding(
        "imu_clocks",
        f"The clocks of camera and IMU differ by {1e3 * clock.seconds:.2f} +- "
        f"{1e3 * clock.sigma:.1g} ms. The result is corrected for it; add it to time_offset.",
        {"offset": clock.seconds, "offset_sigma": clock.sigma},
    )


def _noise(known: Evidence) -> ImuFinding | None:
    ratio = max(known.noise)
    if known.quietest > UNDERSTATED * known.noise_scale:
        return ImuFinding(
            "imu_noise",
            f"Even where the samples are quietest, their noise is {known.quietest:.3g} times that "
            "of the calibration: the IMU has too much weight.",
            {"ratio": 1 / known.quietest},
            ("--imu-noise-scale", f"{known.quietest:.2g}"),
        )
    if ratio <= LARGE_NOISE:
        return None
    sensor = ("gyroscope", "accelerometer")[int(known.noise[1] > known.noise[0])]
    return ImuFinding(
        "imu_noise",
        f"The calibrated noise of the {sensor} is {ratio:.3g} times that of its samples: the IMU "
        "has too little weight to determine the scale.",
        {"sensor": sensor, "ratio": ratio},
    )


def _intervals(known: Evidence) -> ImuFinding | None:
    agreement = known.agreement
    wrong = agreement.wrong_intervals
    if not wrong:
        return None
    rows = [_when(known, k) for k in wrong]
    row, seconds = rows[0]
    return ImuFinding(
        "imu_interval",
        f"Images and IMU contradict each other in {plural(len(wrong), 'interval')} between images,"
        f" most at {seconds:.2f} s ({known.place(row)}).",
        {
            "intervals": wrong, "chi2": agreement.interval_chi2[wrong].tolist(),
            "rows": [row for row, _ in rows], "seconds": [when for _, when in rows],
        },
    )  # fmt: skip
