"""Comparison of two measurements of one rotation: by the tracks and by the gyroscope.

The essential matrix between images i and j gives the rotation of the camera, Exp(c). Integrated
samples give that of the IMU, Exp(g). A right calibration, with R = rotation of camera_from_imu,
bias b and T = t_j - t_i, has

    c = R g - T R b.

The share of c that a matrix M leaves unexplained is median |c - M g - T b| / median |c|, with the
median of c - M g as T b, up to BIAS. Wrong units and axes are other M:

    degrees    R, with samples of pi / 180 of their size
    inverse    R^T: camera_from_imu was given as imu_from_camera
    axes       R P, P one of the 47 other signed permutations: axes of the IMU are swapped or
               reversed, or the IMU is left-handed
    turned     another rotation (Kabsch, Acta Crystallographica 1976)

The shift of the samples that leaves the least of |c - M g - T b| is the time offset that the tracks
imply. Its standard deviation follows from the curvature.
"""

from __future__ import annotations

import math
from copy import copy
from itertools import permutations, product
from typing import Any

import numpy as np

from bundle.base.records import dataclass
from bundle.inertial.tracking.relative_rotation import Turn
from bundle.inertial.vio.sequence_images import ImuSlices
from bundle.interface.finding import Finding
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
    vector_from_quaternion,
)
from bundle.model.sequence.sequence import Recording

Array = np.ndarray[Any, Any]

BIAS = 0.1  # rad/s: largest bias of a gyroscope that is not an error
LEAST_TURN, DEGREE = np.radians(1.0), np.pi / 180
FEWEST, MOST = 15, 300  # pairs of images
SHIFTS = 5e-3 * np.arange(-20, 21)  # s
WRONG, RIGHT = 0.1, 0.25  # shares that reject a matrix, and that a better one must not exceed
BETTER = 0.5  # share of a better matrix, relative to that of the calibration
UNKNOWN = 0.5  # share above which no explanation is a finding, too
AXES = 0.15  # rms rotation about the second axis, relative to the first, for a rotation to follow


@dataclass(frozen=True)
class RotationCheck:
    """Agreement of tracks and gyroscope."""

    num_pairs: int = 0  # number of image pairs with enough rotation; 0: nothing can be compared
    unexplained: float = float("nan")  # share of the rotation beyond the calibration
    cause: str = ""  # "" for agreement, "degrees", "inverse", "axes", "turned", or "unknown"
    cause_unexplained: float = float("nan")  # share beyond this cause; nan without one
    axes: str = ""  # the IMU's axes for cause "axes", such as "+y -x +z"
    ratio: float = float("nan")  # median rotation by the gyroscope / by the tracks
    angle: float = float("nan")  # from camera_from_imu to the rotation of the tracks [degrees]
    angle_sigma: float = float("nan")  # nan if the camera turned about one axis only
    time_shift: float = float("nan")  # seconds to add to the time offset, by the tracks
    time_sigma: float = float("nan")  # its standard deviation; nan if it is not determined


def check_rotations(recording: Recording, turns: list[Turn]) -> RotationCheck:
    """Compare the rotations of image pairs by tracks with those of a recording's samples."""
    pairs = RotationPairs(recording, turns)
    if len(pairs.camera) < FEWEST:
        return RotationCheck()
    lens = pairs.lens
    imu = pairs.imu(0.0)
    cause, matrix, axes = "", lens, ""
    share = best = pairs.unexplained(lens, imu)
    if share > WRONG:
        # A wrong offset of time also disagrees: look for the cause at the best shift.
        found = []
        for shift in (0.0, *_likely_shifts(pairs)):
            moved = pairs.imu(shift)
            found.append((pairs.unexplained(lens, pairs.imu(shift, DEGREE)), "degrees", lens, ""))
            for name, each, text in _causes(lens, pairs.camera, moved):
                found.append((pairs.unexplained(each, moved), name, each, text))
            found.append((pairs.unexplained(lens, moved), "", lens, ""))
        order = {"": 0, "degrees": 1, "inverse": 2, "axes": 3, "turned": 4}
        least = min(entry[0] for entry in found)
        close = [entry for entry in found if entry[0] <= 1.2 * least + 0.02]
        best, cause, matrix, axes = min(close, key=lambda entry: (order[entry[1]], entry[0]))
        if best > min(RIGHT, BETTER * share):
            cause, matrix, axes = ("unknown" if share > UNKNOWN else ""), lens, ""
    is_scaled = cause in ("degrees", "unknown")
    shift, sigma = (float("nan"),) * 2 if is_scaled else _time_shift(pairs, matrix)
    angle, angle_sigma = float("nan"), float("nan")
    if cause in ("", "turned"):
        angle, angle_sigma = _angle(lens, pairs, pairs.imu(shift if np.isfinite(shift) else 0.0))
    return RotationCheck(
        num_pairs=len(pairs.camera),
        unexplained=share,
        cause=cause,
        cause_unexplained=best if cause and cause != "unknown" else float("nan"),
        axes=axes,
        ratio=pairs.ratio(),
        angle=angle,
        angle_sigma=angle_sigma,
        time_shift=shift,
        time_sigma=sigma,
    )


def share_unexplained(recording: Recording, turns: list[Turn]) -> float:
    """Return the share of the rotation that the calibration leaves unexplained; 0 if unknown."""
    pairs = RotationPairs(recording, turns)
    if len(pairs.camera) < FEWEST:
        return 0.0
    return pairs.unexplained(pairs.lens, pairs.imu(0.0))


class RotationPairs:
    """Rotation vectors of image pairs by the tracks, and by samples at a shift of time.

    ``spans``: (n, 2) stamps on the IMU's clock, ns; ``camera``: (n, 3) by the tracks, those below
    ``least_turn`` [rad] are ignored; ``information``: on each; ``lens``: that of camera_from_imu.
    """

    def __init__(
        self, recording: Recording, turns: list[Turn], least_turn: float = LEAST_TURN
    ) -> None:
        stamps = recording.imu_timestamps_ns
        self._slices = ImuSlices(stamps, recording.gyro, recording.accel, "midpoint")
        self._turned: dict[float, Array] = {}
        pose = np.array(recording.calibration.camera_from_imu)
        self.lens: Array = rotation_matrices(pose[None, :4])[0]
        spans = np.array([(each.earlier, each.later) for each in turns], np.int64).reshape(-1, 2)
        vectors = np.zeros((0, 3))
        if turns:
            matrices = np.array([each.rotation for each in turns])
            vectors = vector_from_quaternion(quaternion_from_matrix(matrices))
        most = round(1e9 * SHIFTS[-1])
        kept = (spans[:, 0] - most >= stamps[0]) & (spans[:, 1] + most <= stamps[-1])
        kept &= _norms(vectors) >= least_turn
        rows = np.flatnonzero(kept)
        if len(rows) > MOST:
            rows = rows[np.linspace(0, len(rows) - 1, MOST).round().astype(int)]
        self.spans, self.camera = spans[rows], vectors[rows]
        self.information = np.array([turns[row].information for row in rows]).reshape(-1, 3, 3)
        self.seconds = 1e-9 * float(np.median(np.diff(self.spans))) if len(rows) else 0.0

    def at(self, spans: Array) -> RotationPairs:
        """Return the same rotations of the camera at other stamps."""
        moved = copy(self)
        moved.spans = spans
        return moved

    def imu(self, shift: float, scale: float = 1.0) -> Array:
        """Return (n, 3) later_from_earlier of scaled samples; shifts end at the last sample."""
        spans = (self.spans + round(1e9 * shift)).clip(*self._slices.stamps[[0, -1]])
        earlier, later = (self._orientation(stamps, scale) for stamps in spans.T)
        return vector_from_quaternion(quaternion_multiply(quaternion_inverse(later), earlier))

    def _orientation(self, stamps: Array, scale: float) -> Array:
        """Return quaternions (n, 4) first_from_now at stamps, by scaled samples."""
        times, rates = self._slices.stamps, scale * self._slices.gyro
        steps = 1e-9 * np.diff(times)[:, None]
        if scale not in self._turned:
            turned = quaternion_from_vector(0.5 * steps * (rates[:-1] + rates[1:]))
            for reach in 2 ** np.arange(len(turned).bit_length()):  # products of 2, 4, 8, ... steps
                turned[reach:] = quaternion_multiply(turned[:-reach], turned[reach:])
            self._turned[scale] = np.vstack([[0.0, 0.0, 0.0, 1.0], turned])
        row = np.searchsorted(times[:-1], stamps, "right") - 1
        since = 1e-9 * (stamps - times[row])[:, None]
        middle = rates[row] + 0.5 * since / steps[row] * (rates[row + 1] - rates[row])
        return quaternion_multiply(self._turned[scale][row], quaternion_from_vector(since * middle))

    def ratio(self) -> float:
        """Return the median size by the gyroscope / by the tracks; a small scale avoids wraps."""
        sizes = _norms(self.imu(0.0, DEGREE)) / DEGREE
        return float(np.median(sizes) / np.median(_norms(self.camera)))

    def errors(self, matrix: Array, imu: Array) -> Array:
        """Return c - M g - T b (n, 3) with the best plausible bias."""
        errors = self.camera - imu @ matrix.T
        drift: Array = np.median(errors, axis=0)
        length = float(np.linalg.norm(drift))
        most = BIAS * self.seconds
        left: Array = errors - drift * min(1.0, most / length if length > 0 else 1.0)
        return left

    def unexplained(self, matrix: Array, imu: Array) -> float:
        """Return the share of the rotation (above) that a matrix leaves unexplained."""
        errors = _norms(self.errors(matrix, imu))
        return float(np.median(errors) / np.median(_norms(self.camera)))


def _kabsch(camera: Array, imu: Array) -> Array:
    """Return the rotation that takes one set of vectors to the other, with robust weights."""
    rotation = np.eye(3)
    weight = np.ones(len(camera))
    for _ in range(10):
        u, _, vt = np.linalg.svd((weight[:, None] * camera).T @ imu)
        rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        errors = np.linalg.norm(camera - imu @ rotation.T, axis=1)
        weight = 1 / (1 + (errors / max(float(np.median(errors)), 1e-9)) ** 2)
    return rotation


def _causes(lens: Array, camera: Array, imu: Array) -> list[tuple[str, Array, str]]:
    found = [("inverse", lens.T, "")]
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3))
            axes[range(3), order] = signs
            if not np.array_equal(axes, np.eye(3)):
                words = " ".join("-+"[s > 0] + "xyz"[k] for s, k in zip(signs, order, strict=True))
                found.append(("axes", lens @ axes, words))
    return [*found, ("turned", _kabsch(camera, imu), "")]


def _angle(lens: Array, pairs: RotationPairs, imu: Array) -> tuple[float, float]:
    """Return the angle to the rotation that tracks imply, and its standard deviation, degrees."""
    drift = np.median(pairs.camera - imu @ lens.T, axis=0)
    rotation = _kabsch(pairs.camera - drift, imu)
    errors = pairs.camera - drift - imu @ rotation.T
    spread = np.linalg.svd(imu, compute_uv=False)
    cosine = (float(np.trace(rotation @ lens.T)) - 1) / 2
    angle = float(np.degrees(np.arccos(min(1.0, max(-1.0, cosine)))))
    if spread[1] < AXES * spread[0]:
        return angle, float("nan")
    # Consecutive pairs share images: about one in five is independent.
    sigma = 1.48 * float(np.median(np.abs(errors))) * np.sqrt(5.0) / float(spread[1])
    return angle, float(np.degrees(sigma))


def _likely_shifts(pairs: RotationPairs) -> list[float]:
    """Return the shift at which the angles of rotations, independent of axes, agree best."""
    sizes = _norms(pairs.camera)
    scores = []
    for shift in SHIFTS:
        turned = _norms(pairs.imu(float(shift)))
        scores.append(float(np.corrcoef(sizes, turned)[0, 1]) if turned.std() > 0 else -1.0)
    return [float(SHIFTS[int(np.argmax(scores))])]


def _time_shift(pairs: RotationPairs, matrix: Array) -> tuple[float, float]:
    """Return the best shift and its standard deviation by a parabola through the cost.

    The cost of a shift is that with the best rotation near the matrix: a rotation that is slightly
    wrong looks like a shift. If the best shift is the last, those beyond are tried, too.
    """
    scale = 1.48 * float(np.median(np.abs(pairs.errors(matrix, pairs.imu(0.0)))))
    scale = max(scale, 1e-6)

    def cost(shift: float) -> float:
        imu = pairs.imu(shift)
        drift = np.median(pairs.camera - imu @ matrix.T, axis=0)
        turned = _kabsch(pairs.camera - drift, imu @ matrix.T) @ matrix
        errors = pairs.errors(turned, imu) / scale
        return float(np.log1p((errors**2).sum(axis=1)).sum())

    middle = 0.0
    for _ in range(2):
        costs = [cost(middle + float(shift)) for shift in SHIFTS]
        best = int(np.argmin(costs))
        if 0 < best < len(SHIFTS) - 1:
            break
        middle += float(SHIFTS[best])
    else:
        return float("nan"), float("nan")
    before, least, after = costs[best - 1 : best + 2]
    step = float(SHIFTS[1] - SHIFTS[0])
    curvature = (before - 2 * least + after) / step**2
    if curvature <= 0:
        return float("nan"), float("nan")
    shift = middle + float(SHIFTS[best]) + (before - after) / (2 * step * curvature)
    return shift, float(np.sqrt(2 / curvature))


def _norms(vectors: Array) -> Array:
    norms: Array = np.linalg.norm(vectors, axis=1)
    return norms


SIGMAS = 4.0
LEAST_SHIFT, LEAST_PERIODS = 3e-3, 0.6  # s; of samples, whose means are half a period late
LEAST_ANGLE = 2.0  # degrees
REFUSED_ANGLE = 15.0  # degrees


def tracking_findings(recording: Recording, check: RotationCheck) -> tuple[Finding, ...]:
    """Return the findings; those with ``is_problem`` spoil an odometry."""
    names = ("num_pairs", "unexplained", "cause_unexplained", "ratio", "time_shift", "angle")
    evidence = {name: getattr(check, name) for name in names}
    share = f"{100 * check.unexplained:.0f} %"
    explained = f"{100 * check.cause_unexplained:.0f} %" if check.cause else ""
    table, pairs = recording.imu_place(len(recording.gyro)), f"{check.num_pairs} image pairs"
    if check.cause:
        sentence = {
            "degrees": f"{table}: gyro: expected rad/s, found rotations {check.ratio:.1f} times "
            f"as large as those of the tracks (median of {pairs}); read as degrees/s, they differ "
            f"by {explained}",
            "inverse": f"{recording.name}: camera_from_imu: expected the rotation that the tracks "
            f"show in {pairs}, found its inverse: {share} of the motion disagrees as given, only "
            f"{explained} with the inverse",
            "axes": f"{table}: axes: expected gyroscope axes that agree with the tracks in "
            f"{pairs}, found that {share} of the rotation disagrees, but only {explained} "
            f"with axes {check.axes} in place of +x +y +z: axes are swapped or reversed, or "
            "camera_from_imu is wrong",
            "turned": f"{recording.name}: camera_from_imu: expected the rotation that the tracks "
            f"show in {pairs}, found that {share} of the motion disagrees, but only {explained} "
            "with another rotation",
            "unknown": f"{recording.name}: expected rotations of the gyroscope that agree with the "
            f"tracks, found that {share} disagrees in {pairs}: wrong stamps, axes or calibration",
        }[check.cause]
        kind = {"degrees": "gyro units", "unknown": "rotation"}.get(check.cause, "axes")
        # Rays of one plane, or of a narrow lens, confuse small rotations with translations.
        is_wrong = check.cause != "turned" or check.angle > REFUSED_ANGLE
        return (Finding(kind=kind, sentence=sentence, evidence=evidence, is_problem=is_wrong),)
    found = []
    shift, sigma = check.time_shift, check.time_sigma
    period = 1e-9 * float(np.median(np.diff(recording.imu_timestamps_ns)))
    least = max(LEAST_SHIFT, LEAST_PERIODS * period)
    if math.isfinite(sigma) and abs(shift) > max(least, SIGMAS * sigma):
        used = 1e3 * recording.calibration.time_offset
        found.append(
            Finding(
                kind="time offset",
                sentence=f"{recording.name}: time offset: the tracks imply "
                f"{1e3 * shift + used:.1f} ms (sigma {1e3 * sigma:.1f}) instead of {used:.1f} ms; "
                "--refine-time-offset estimates it",
                evidence=evidence,
            )
        )
    limit = max(LEAST_ANGLE, SIGMAS * check.angle_sigma)  # nan: nothing follows
    if math.isfinite(check.angle_sigma) and check.angle > limit:
        found.append(
            Finding(
                kind="axes",
                sentence=f"{recording.name}: camera_from_imu: the tracks imply a rotation "
                f"{check.angle:.1f} degrees from the given one (sigma {check.angle_sigma:.1f}); "
                "--refine-extrinsics estimates it",
                evidence=evidence,
            )
        )
    return tuple(found)
