"""Initial states of a sequence: from rest, or from motion by tracks and IMU samples.

If a sequence begins at rest, samples give its tilt and gyroscope bias
(:mod:`bundle.inertial.vio.initialize`). Otherwise spans of two seconds are tried, one after the
other, until the linear start of one (:mod:`bundle.inertial.vio.linear_start`) passes every test:

* tracks: at least three images observe enough of them;
* parallax: after removing the gyroscope's rotation, rays still move between a point's first and
  last image; without translation neither depth nor scale is observable;
* in front of the camera: points behind a camera show that the solution is a wrong minimum;
* biases: their size is plausible for sensors;
* certainty: the distance is known to a tenth of its length, which requires acceleration.

The world of a start has z up and its origin at the first image; its yaw is that of the shortest
rotation that levels the IMU.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.base.arrays import check_type
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.inertial.vio.linear_start import LinearStart, Observations, solve_linear_start
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.option_fields import number
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_multiply,
    quaternion_rotate,
    rotation_matrices,
)
from bundle.model.sequence.calibration import Calibration
from bundle.model.sequence.sequence import Sequence

Array = np.ndarray[Any, Any]

# s: length of a span, step between spans, start of the last span
SPAN, STRIDE, LATEST = 2.0, 0.5, 30.0
IMAGES = 12
LEAST_TRACKS, LEAST_VIEWS = 10, 3
LEAST_PARALLAX = 8.0  # sigmas
MOST_BEHIND = 0.02
MOST_GYRO_BIAS, MOST_ACCEL_BIAS = 0.5, 0.3  # rad/s, m/s^2
MOST_SCALE_SIGMA = 0.1


@dataclass(frozen=True, eq=False, repr=False)
class VioStart(Displayed):
    """Initial states of a sequence, or the reason why they are missing.

    Attributes:
        kind: "static", "moving", or "none".
        reason: reason for "none" (of the last span): "too few tracks", "no parallax", "points
            behind the camera", "biases too large", "no excitation"; empty otherwise.
        images: (k,) indices of the images in :meth:`Sequence.frames`.
        timestamps_ns: (k,) on the IMU's clock.
        states: (k, 16) rows qx qy qz qw, position [m], velocity [m/s], gyroscope and accelerometer
            bias; world_from_imu, the world's z axis up.
        track_ids: (m,) ids of the points; empty for a start at rest.
        points: (m, 3) in the world [m].
        gravity_sigma: standard deviation of the tilt [rad]; nan for a start at rest.
        scale_sigma: relative standard deviation of the distance between first and last image; nan
            for a start at rest.
        median_error: median reprojection error in sigmas; nan for a start at rest.
    """

    kind: str
    reason: str
    images: Array
    timestamps_ns: Array
    states: Array
    track_ids: Array
    points: Array
    gravity_sigma: float = float("nan")
    scale_sigma: float = float("nan")
    median_error: float = float("nan")

    def __bool__(self) -> bool:
        return self.kind != "none"

    def _display(self) -> Display:
        if not self:
            return Display(title=f"No start: {self.reason}")
        return Display(
            title=f"Start of {len(self.states)} images, {self.kind}",
            facts=(
                ("points", f"{len(self.points)}"),
                ("tilt", f"{np.degrees(self.gravity_sigma):.3g} degrees (sigma)"),
                ("scale", f"{100 * self.scale_sigma:.3g} % (sigma)"),
            ),
        )


class Span(NamedTuple):
    """Images over two seconds, and observations of points in three or more of them."""

    images: Array
    seen: Observations
    track_ids: Array


def initialize_vio(
    sequence: Sequence,
    *,
    gravity: float = 9.81,
    integration: str = "zero_order_hold",
    try_rest: bool = True,
) -> VioStart:
    """Find the initial states of a sequence without prior knowledge of its pose.

    Args:
        sequence: IMU samples, tracks and calibration.
        gravity: magnitude of gravity [m/s^2].
        integration: rule of :class:`bundle.Preintegration`.
        try_rest: test first if the sequence starts at rest.

    Returns:
        Start, true as a condition if one was found.

    Raises:
        InputError: an argument has a wrong type or range.
    """
    check_type("sequence", sequence, Sequence)
    gravity = number("gravity", gravity, above=0)
    return find_start(SequenceImages(sequence, integration), gravity, integration, try_rest)


def find_start(
    images: SequenceImages, gravity: float, integration: str, try_rest: bool = True
) -> VioStart:
    """Find the initial states of a sequence's images; see :func:`initialize_vio`."""
    stamps = images.stamps
    rest = find_static_start(images, gravity) if try_rest else None
    if rest is not None:
        ends = np.array([rest.first_image, rest.last_image])
        return VioStart(
            kind="static",
            reason="",
            images=ends,
            timestamps_ns=stamps[ends],
            states=np.repeat(rest.state[None], 2, axis=0),
            track_ids=np.zeros(0, np.int64),
            points=np.zeros((0, 3)),
        )
    covered = np.flatnonzero(images.covered)
    calibration = images.sequence.calibration
    reason, begin, next_stamp = "too few tracks", 0, stamps[covered[0]]
    latest = min(stamps[covered[0]] + round(1e9 * LATEST), stamps[covered[-1]])
    while next_stamp <= latest:
        begin = int(np.searchsorted(stamps, next_stamp))
        next_stamp += round(1e9 * STRIDE)
        span = find_span(images, begin, int(covered[-1]))
        if span is None:
            continue
        found = span_start(images, span, gravity, integration)
        reason = objection_to(found, span, calibration)
        if not reason:
            return _levelled(found, span, stamps[span.images])
    nothing = np.zeros(0, np.int64)
    return VioStart("none", reason, nothing, nothing, np.zeros((0, 16)), nothing, np.zeros((0, 3)))


def span_start(images: SequenceImages, span: Span, gravity: float, integration: str) -> LinearStart:
    """Return the linear start of a span."""
    calibration = images.sequence.calibration
    return solve_linear_start(
        images.intervals(span.images.tolist()),
        span.seen,
        np.array(calibration.camera_from_imu),
        calibration.noise,
        calibration.pixel_sigma / calibration.focal,
        np.zeros(3),
        gravity,
        integration,
    )


def find_span(images: SequenceImages, first: int, end: int) -> Span | None:
    """Return images over two seconds and their points in three or more images, if sufficient."""
    stamps = images.stamps
    last = int(np.searchsorted(stamps, stamps[first] + round(1e9 * SPAN), "right")) - 1
    last = min(last, end)
    chosen = np.unique(np.linspace(first, last, IMAGES).round().astype(int))
    if len(chosen) < LEAST_VIEWS or stamps[last] - stamps[first] < 0.75e9 * SPAN:
        return None
    rows = [np.arange(images.begin[image], images.begin[image + 1]) for image in chosen]
    place = np.repeat(np.arange(len(chosen)), [len(part) for part in rows])
    row = np.concatenate(rows)
    _, point, views = np.unique(images.ids[row], return_inverse=True, return_counts=True)
    kept = views[point] >= LEAST_VIEWS
    row, place = row[kept], place[kept]
    ids, seen_at, point = np.unique(images.ids[row], return_index=True, return_inverse=True)
    if len(ids) < LEAST_TRACKS:
        return None
    order = np.lexsort((place, point))
    seen = Observations(point[order], place[order], images.xy[row[order]])
    return Span(chosen, seen, images.track_ids[row[seen_at]])


def objection_to(found: LinearStart, span: Span, calibration: Calibration) -> str:
    """Return the name of the test that a solution fails; "" if it passes all tests."""
    seen = span.seen
    turn = rotation_matrices(np.array(calibration.camera_from_imu)[None, :4])[0]
    rays = np.column_stack([seen.xy, np.ones(len(seen.xy))]) @ turn
    rays = np.einsum("nij,nj->ni", found.rotations[seen.image], rays)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ends = np.append(np.flatnonzero(np.diff(seen.point)), len(rays) - 1)
    starts = np.append(0, ends[:-1] + 1)
    angles = np.linalg.norm(np.cross(rays[starts], rays[ends]), axis=1)
    if np.median(angles) * calibration.focal < LEAST_PARALLAX * calibration.pixel_sigma:
        return "no parallax"
    if not np.isfinite(found.positions).all() or np.mean(found.depths <= 0) > MOST_BEHIND:
        return "points behind the camera"
    gyro, accel = np.linalg.norm(found.gyro_bias), np.linalg.norm(found.accel_bias)
    if not (gyro < MOST_GYRO_BIAS and accel < MOST_ACCEL_BIAS):
        return "biases too large"
    return "" if found.scale_sigma < MOST_SCALE_SIGMA else "no excitation"


def _levelled(found: LinearStart, span: Span, stamps: Array) -> VioStart:
    up = level_quaternion(-found.gravity)

    def turned(vectors: Array) -> Array:
        return quaternion_rotate(np.tile(up, (len(vectors), 1)), vectors)

    count = len(stamps)
    states = np.empty((count, 16))
    rotations = quaternion_from_matrix(found.rotations)
    states[:, :4] = quaternion_multiply(np.tile(up, (count, 1)), rotations)
    states[:, 4:7], states[:, 7:10] = turned(found.positions), turned(found.velocities)
    states[:, 10:13], states[:, 13:] = found.gyro_bias, found.accel_bias
    return VioStart(
        kind="moving",
        reason="",
        images=span.images,
        timestamps_ns=stamps,
        states=states,
        track_ids=span.track_ids,
        points=turned(found.points),
        gravity_sigma=found.gravity_sigma,
        scale_sigma=found.scale_sigma,
        median_error=float(np.median(np.linalg.norm(found.residuals, axis=1))),
    )


# Start at rest: gravity from the accelerometer, gyroscope bias from the mean rate.
#
# At rest the specific force is -g in the IMU frame, so its mean f gives the tilt: the shortest
# rotation that takes f to the world's z axis; yaw is arbitrary. The difference of |f| and |g| is
# the accelerometer bias along gravity, which the window estimates.
#
# A vehicle counts as at rest while its tracks stay at their first positions, up to noise, and the
# mean rate does not change. IMU samples alone are not sufficient. Rotors that spin on the ground
# shake an accelerometer more than slow flight does.
#
# Two positions of a track, each with noise s in both coordinates, have a median distance of 1.7 s.

REST_SIGMAS = 3.0  # median displacement of the tracks; noise alone gives 1.7
FEWEST_TRACKS = 4
REST_RATE = 0.03  # rad/s: change of the mean rate
REST_WINDOW = 0.5  # s, for that mean


def rest_at_start(images: SequenceImages) -> tuple[int, int]:
    """Return the last image and the number of samples at rest at the start; (first, 0): none."""
    sequence = images.sequence
    first = int(np.argmax(images.covered))
    last = _last_still_image(images, first)
    stamps, gyro = sequence.imu_timestamps_ns, sequence.gyro
    end = int(images.stamps[last])
    samples = int(np.searchsorted(stamps, end, side="right")) if last > first else 0
    size = int(np.searchsorted(stamps, stamps[0] + round(1e9 * REST_WINDOW)))
    if samples < size or size < 2:
        return first, 0
    means = gyro[: samples // size * size].reshape(-1, size, 3).mean(axis=1)
    turned = np.flatnonzero(np.abs(means - means[0]).max(axis=1) > REST_RATE)
    if len(turned):
        samples = int(turned[0]) * size
        still = np.flatnonzero(images.stamps <= stamps[samples - 1])
        last = max(first, int(still[-1])) if len(still) else first
    return last, samples


def _last_still_image(images: SequenceImages, first: int) -> int:
    calibration = images.sequence.calibration
    rows = slice(int(images.begin[first]), None)
    xy: Any = calibration.focal * images.xy[rows]
    _, seen, track = np.unique(images.ids[rows], return_index=True, return_inverse=True)
    moved = np.linalg.norm(xy - xy[seen[track]], axis=1)
    is_seen_again = seen[track] != np.arange(len(xy))
    begin = images.begin - images.begin[first]
    last = first
    for image in range(first + 1, len(images)):
        rows = slice(begin[image], begin[image + 1])
        again = is_seen_again[rows]
        if not images.covered[image] or again.sum() < FEWEST_TRACKS:
            break
        if np.median(moved[rows][again]) > REST_SIGMAS * calibration.pixel_sigma:
            break
        last = image
    return last


LONGEST = 10.0  # s, longest time at rest that is used
SHORTEST = 0.5
GYRO_SCATTER = 0.06  # rad/s: motors shake, but the platform does not turn
ACCEL_SCATTER = 0.8  # m/s^2


class StaticStart(NamedTuple):
    """State (16,) at rest at its origin, and the first and last image at rest."""

    state: Array
    first_image: int
    last_image: int


def find_static_start(images: SequenceImages, gravity: float = 9.81) -> StaticStart | None:
    """Return the rest at the start of a sequence, or None if it begins in motion.

    Rest is defined as in :func:`rest_at_start` and must last at least half a second. Standard
    deviations must be at most 0.06 rad/s (gyroscope) and 0.8 m/s^2 (accelerometer). The mean force
    must be within 1 m/s^2 of gravity.
    """
    sequence, stamps = images.sequence, images.stamps
    first = int(np.argmax(images.covered))
    last, _ = rest_at_start(images)
    limit = stamps[first] + round(1e9 * LONGEST)
    last = min(last, int(np.searchsorted(stamps, limit, "right")) - 1)
    # Tracks show motion slightly later than the platform moves.
    until = stamps[first] + int(0.8 * (stamps[last] - stamps[first]))
    last = int(np.searchsorted(stamps, until, "right")) - 1
    if stamps[last] - stamps[first] < 1e9 * SHORTEST:
        return None
    t = sequence.imu_timestamps_ns
    rest = slice(int(np.searchsorted(t, stamps[first])), int(np.searchsorted(t, stamps[last])))
    gyro, accel = sequence.gyro[rest], sequence.accel[rest]
    mean = accel.mean(axis=0)
    if (
        np.linalg.norm(gyro.std(axis=0)) > GYRO_SCATTER
        or np.linalg.norm(accel.std(axis=0)) > ACCEL_SCATTER
        or abs(np.linalg.norm(mean) - gravity) > 1.0
    ):
        return None
    state = np.zeros(16)
    state[:4] = level_quaternion(mean)
    state[10:13] = gyro.mean(axis=0)
    return StaticStart(state, first, last)


def level_quaternion(force: Array) -> Array:
    """Return the quaternion x y z w of the shortest rotation that takes a force to the z axis."""
    up = force / np.linalg.norm(force)
    w = 1.0 + up[2]
    if w < 1e-9:  # upside down: half a turn about x
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([up[1], -up[0], 0.0, w])  # up x z, 1 + up . z
    level: Array = quaternion / np.linalg.norm(quaternion)
    return level
