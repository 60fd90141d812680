"""Alarms of a window's telemetry.

Some indicators raise an alarm at once. Others, which healthy windows show briefly, must persist:
two keyframes, five without excitation, a trend over fifty.

The cost of a prior is at least 0. It is half a chi-square, whose degrees of freedom are the
prior's number of coordinates. Healthy windows have about 0.1 per coordinate. The cost exceeds 1
per coordinate if wrong tracks or a wrong calibration were marginalised into the prior.

Biases are random walks. Let b(s) be the estimate at time s, with variances P(s), and q the density
of the walk. The later estimate b(t) is the expectation of the true bias given more measurements, so
that the variance of b(t) - b(s) is at most that of the true change, P(s) + q^2 (t - s). Over three
axes, the sum of squared changes over their variances thus has at most chi2 with three degrees of
freedom. Its root, largest over all s, is up to 1.9 in two clean flights and 3.6 on EuRoC V1_01. If
a bias moves faster, its estimate lags behind, and velocities are off by about as many of their
sigmas: in 60 runs with sensors that warm up, the rms error of positions was 0.5 to 1.8 s times so
many sigmas of the velocity along the axis of the largest.

No sensor measures the heading. Once a prior has set its sigma, the sigma must not fall, except by
fluctuations between images. Medians of five keyframes remove these.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.interface.window_options import WindowOptions

Array = np.ndarray[Any, Any]

LARGEST_ASYMMETRY = 1e-9
SMALLEST_RATIO = 1e-8
INDEFINITE = -1e-9  # with a unit diagonal: beyond the rounding of double precision
LARGEST_IMU_EXCESS = 3.0  # up to 1.6 in flights with correct noise
LARGEST_GYRO_BIAS, LARGEST_ACCEL_BIAS = 1.0, 2.5  # rad/s, m/s^2: failure limits of VINS-Mono
LARGEST_PRIOR_COST = 1.0  # per coordinate
LEAST_PRIOR_COST = -0.1  # per coordinate: rounding errors are 1e-6
BIAS_SIGMAS = 6.0
LARGEST_LAG, LAG_SHARE = 0.2, 0.05  # m/s, share of the speed: error of velocities by a bias
KEYFRAMES, QUIET_KEYFRAMES = 2, 5  # consecutive
BLOCK, BLOCKS, DECADES = 10, 5, 1.0  # of a decreasing ratio
YAW_MEDIAN, YAW_FALL, YAW_TURN = 5, 0.98, 0.3  # keyframes, ratio, rad


def walks_down(ratios: list[float]) -> bool:
    """Return True if ratios fall steadily: medians of five blocks of ten, by a decade in total."""
    if len(ratios) < BLOCK * BLOCKS:
        return False
    last = np.log10(np.maximum(ratios[-BLOCK * BLOCKS :], 1e-300)).reshape(BLOCKS, BLOCK)
    medians = np.median(last, axis=1)
    return bool(np.all(np.diff(medians) < 0) and medians[0] - medians[-1] > DECADES)


def yaw_falls(sigmas: list[float], turned: list[float]) -> tuple[float, float] | None:
    """Return yaw's sigma before and after it fell while the platform turned; None if not."""
    if len(sigmas) < 2 * YAW_MEDIAN:
        return None
    windows = np.lib.stride_tricks.sliding_window_view(np.array(sigmas), YAW_MEDIAN)
    medians = np.median(windows, axis=1)
    largest = int(np.argmax(medians[:-YAW_MEDIAN]))
    if turned[-1] - turned[largest + YAW_MEDIAN // 2] < YAW_TURN:
        return None
    found = float(medians[largest]), float(medians[-1])
    return found if found[1] < YAW_FALL * found[0] else None


class WindowAlarms:
    """Alarms of consecutive keyframes; ``walks``: densities of the biases' random walks."""

    def __init__(self, options: WindowOptions, walks: tuple[float, float]) -> None:
        self.options, self._walks = options, walks
        self._stamps: list[int] = []
        self._biases: list[Array] = []  # (2, 6) of these stamps: estimates and their variances
        self._velocity_sigma = 0.0  # m/s
        self._ratios: list[float] = []
        self._yaws: list[float] = []
        self._turned: list[float] = []
        self._in_a_row: dict[str, int] = {}
        self._excess: list[float] = []

    def of(
        self,
        state: Array,
        nullity: tuple[int | None, int],
        prior: dict[str, float | None],
        prior_cost: tuple[float, int],
        verdict: str,
        yaw: tuple[float | None, float],
        changes: Array,
    ) -> tuple[str, ...]:
        """Return the alarms of a keyframe; ``nullity``: found, expected; ``yaw``: sigma, turned."""
        alarms = [*self._of_prior(nullity, prior, prior_cost), *self._of_biases(state, changes)]
        if self._persists("excitation", verdict == "unobservable", QUIET_KEYFRAMES):
            alarms.append(NO_EXCITATION)
        if yaw[0] is not None:
            self._yaws.append(yaw[0])
            self._turned.append(yaw[1])
            fall = yaw_falls(self._yaws, self._turned)
            if fall is not None:
                before, now = np.degrees(fall)
                alarms.append(
                    f"sigma of yaw falls: from {before:.3g} to {now:.3g} degrees while the "
                    "platform turned, but no sensor measures yaw: Jacobians are inconsistent"
                )
        return tuple(alarms)

    def of_imu(self, excess: float | None, is_new: bool) -> tuple[str, ...]:
        """Return the alarm of an excessive IMU cost, after two checks in a row."""
        if excess is None:
            return ()
        if is_new:
            self._excess = [*self._excess[-1:], excess]
        if len(self._excess) < KEYFRAMES or min(self._excess) <= LARGEST_IMU_EXCESS:
            return ()
        return (
            f"{DISAGREEMENT}: the IMU cost is "
            f"{excess:.1f} times what its noise explains; camera_from_imu, the time "
            "offset, the focal length, a rolling shutter or the noise is wrong, or a bias jumped",
        )

    def _persists(self, kind: str, is_seen: bool, count: int = KEYFRAMES) -> bool:
        self._in_a_row[kind] = self._in_a_row.get(kind, 0) + 1 if is_seen else 0
        return self._in_a_row[kind] >= count

    def _of_prior(
        self,
        nullity: tuple[int | None, int],
        prior: dict[str, float | None],
        prior_cost: tuple[float, int],
    ) -> list[str]:
        alarms = []
        if nullity[0] is not None and nullity[0] < nullity[1]:
            alarms.append(
                f"nullity {nullity[0]} instead of {nullity[1]}: the window gained information "
                "on position or yaw that no sensor measures"
            )
        asymmetry, ratio = prior["prior_asymmetry"], prior["prior_ratio"]
        if asymmetry is not None and asymmetry > LARGEST_ASYMMETRY:
            alarms.append(f"prior asymmetric: by {asymmetry:.1e}, from rounding errors")
        definiteness = prior["prior_definiteness"]
        if definiteness is not None and definiteness < INDEFINITE:
            alarms.append(f"prior not positive: eigenvalue ratio {definiteness:.1e}")
        elif self._persists("singular", ratio is not None and ratio < SMALLEST_RATIO):
            alarms.append(f"prior close to singular: eigenvalue ratio {ratio:.1e}")
        if ratio is not None:
            self._ratios = [*self._ratios[1 - BLOCK * BLOCKS :], ratio]
            if walks_down(self._ratios):
                alarms.append(
                    f"prior loses digits: its eigenvalue ratio fell from {self._ratios[0]:.1e} to "
                    f"{ratio:.1e} in {len(self._ratios)} keyframes, without recovering"
                )
        cost, size = prior_cost
        if cost < LEAST_PRIOR_COST * size:
            alarms.append(f"prior cost negative: {cost:.3g}; rounding errors dominate the prior")
        if self._persists("cost", cost > LARGEST_PRIOR_COST * size):
            advice = " (against wrong tracks use a more robust --loss, such as cauchy)"
            advice = "" if self.options.loss == "cauchy" else advice
            alarms.append(
                f"prior contradicted: it costs {cost:.3g} with {size} coordinates; wrong tracks, "
                f"wrong samples or a wrong calibration were marginalised into it{advice}"
            )
        return alarms

    def know_biases(self, stamp: int, state: Array, covariance: Array) -> None:
        """Store the biases of a state with its covariance (15, 15), for later changes."""
        self._stamps.append(stamp)
        self._biases.append(np.stack([state[10:16], np.diag(covariance)[9:]]))
        self._velocity_sigma = float(np.linalg.norm(covariance[6:9, 6:9], 2)) ** 0.5

    def bias_changes(self, stamp: int, state: Array) -> Array:
        """Return sigmas, sizes and seconds (3, 2) of both biases' largest changes so far."""
        if not self._biases:
            options = self.options
            sigmas = (options.start_gyro_bias_sigma, options.start_accel_bias_sigma)
            self.know_biases(stamp, state, np.diag(np.repeat([0.0, 0.0, 0.0, *sigmas], 3) ** 2))
        known = np.array(self._biases)
        seconds = 1e-9 * (stamp - np.array(self._stamps))
        variances = known[:, 1] + np.outer(seconds, np.repeat(self._walks, 3) ** 2)
        squares = (state[10:16] - known[:, 0]) ** 2
        sizes, chi2 = (x.reshape(-1, 2, 3).sum(axis=2) for x in (squares, squares / variances))
        rows = chi2.argmax(axis=0), np.arange(2)
        return np.stack([np.sqrt(chi2[rows]), np.sqrt(sizes[rows]), seconds[rows[0]]])

    def _of_biases(self, state: Array, changes: Array) -> list[str]:
        alarms = []
        if np.linalg.norm(state[10:13]) > LARGEST_GYRO_BIAS:
            alarms.append("gyroscope bias above 1 rad/s: the window lost track")
        if np.linalg.norm(state[13:16]) > LARGEST_ACCEL_BIAS:
            alarms.append("accelerometer bias above 2.5 m/s^2: the window lost track")
        most = max(LARGEST_LAG, LAG_SHARE * float(np.linalg.norm(state[7:10])))
        for name, unit, key, sigmas, size, seconds in zip(*BIASES, *changes, strict=True):
            if self._persists(name, sigmas > BIAS_SIGMAS):
                walk, lag = size / max(seconds, 1.0) ** 0.5, sigmas * self._velocity_sigma
                alarms.append(
                    f"{name} bias {LAGS if lag > most else 'changes'}: by {size:.3g} {unit} within "
                    f"{seconds:.3g} s, {sigmas:.1f} sigmas of the earlier estimate and the random "
                    f"walk: velocities may be off by {lag:.2g} m/s; if the sensor warms "
                    f"up, {key} of {walk:.1g} allows for it"
                )
        return alarms


BIASES = (
    ("gyroscope", "accelerometer"),
    ("rad/s", "m/s^2"),
    ("gyro_bias_random_walk", "accel_bias_random_walk"),
)
LAGS = "changes too fast to follow"
DISAGREEMENT = "camera and IMU contradict each other"
NO_EXCITATION = "no excitation: the accelerometer does not determine the scale, which may drift"
