"""Preintegration of IMU samples between two states, propagation by samples, excitation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import Array as Declared
from bundle.base.arrays import as_array, as_declared, check_type, check_values
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.model.sequence.calibration import ImuNoise

Array = NDArray[np.float64]

RULES = ("zero_order_hold", "midpoint")


def as_vector(name: str, value: ArrayLike, size: int = 3) -> Array:
    """Return finite numbers as an array (size,)."""
    vector: Array = as_declared(name, value, Declared((size,), "finite"))
    return vector


class Preintegration(Displayed):
    """Motion between two states by IMU samples, in the IMU frame of the first state.

    Let f and w be samples of accelerometer and gyroscope minus their biases. (R, v, p) starts at
    (I, 0, 0). An interval dt moves it first to p + v dt + 1/2 R f dt^2, then to v + R f dt, then
    to R Exp(w dt). The states add gravity (:class:`ImuFactor`). Forster, Carlone, Dellaert and
    Scaramuzza, "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry", TRO 2017;
    ``cpp/core/inertial/preintegration.cpp`` has the derivation.

    The samples are stored: :meth:`corrected` adapts to new biases to first order,
    :meth:`needs_repropagation` is true if that is not accurate enough, :meth:`repropagated`
    integrates again. Example::

        motion = bundle.Preintegration(noise, gyro_bias, accel_bias)
        motion.integrate(gyro, accel, dt)
        graph.add_factor(bundle.ImuFactor("x0", "v0", "b0", "x1", "v1", motion))

    Args:
        noise: a :class:`bundle.ImuNoise`.
        gyro_bias: (3,) rad/s, subtracted from each sample.
        accel_bias: (3,) m/s^2.
        rule: "zero_order_hold": a sample holds for the next interval; "midpoint": the mean of the
            samples at both ends of an interval.

    Raises:
        InputError: a bias is not three finite numbers, or the rule is unknown.
    """

    def __init__(
        self,
        noise: ImuNoise,
        gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
        accel_bias: ArrayLike = (0.0, 0.0, 0.0),
        *,
        rule: str = "zero_order_hold",
    ) -> None:
        check_type("Preintegration: noise", noise, ImuNoise)
        self._noise = noise
        self._rule = choice("Preintegration: rule", rule, RULES)
        self._gyro_bias = as_vector("Preintegration: gyro_bias", gyro_bias).copy()
        self._accel_bias = as_vector("Preintegration: accel_bias", accel_bias).copy()
        for bias in (self._gyro_bias, self._accel_bias):
            bias.flags.writeable = False
        self._motion = _core.Preintegration(
            noise.astuple(), self._gyro_bias, self._accel_bias, self._rule
        )

    def __reduce__(self) -> tuple[Any, ...]:
        state = (self._noise, self._gyro_bias, self._accel_bias, self._rule, self.samples)
        return _restored, state

    def integrate(self, gyro: ArrayLike, accel: ArrayLike, dt: ArrayLike) -> None:
        """Integrate the next samples.

        Args:
            gyro: (n, 3) rad/s. With midpoint (n + 1, 3), a sample at each end of an interval: the
                first row of a call is the last one of the previous call.
            accel: specific force in m/s^2, likewise; about +9.81 upwards at rest.
            dt: (n,) seconds, each above 0.

        Raises:
            InputError: shapes do not fit, a number is not finite, or a time is not above 0; nothing
                is integrated then.
        """
        times = as_array("dt", dt)
        if times.size and times.max() > 10:
            raise InputError(f"dt: expected seconds, found {times.max():g}; nanoseconds?")
        self._motion.integrate(as_array("gyro", gyro), as_array("accel", accel), times)

    def append(self, following: Preintegration) -> None:
        """Integrate the samples of the next interval, at the biases of this one.

        Raises:
            InputError: the other interval was integrated by another rule.
        """
        check_type("append", following, Preintegration)
        self._motion.append(following._motion)

    def repropagated(self, gyro_bias: ArrayLike, accel_bias: ArrayLike) -> Preintegration:
        """Return the same samples integrated at other biases.

        Raises:
            InputError: a bias is not three finite numbers.
        """
        again = Preintegration(self._noise, gyro_bias, accel_bias, rule=self._rule)
        again._motion = self._motion.repropagated(again._gyro_bias, again._accel_bias)
        return again

    def corrected(self, gyro_bias: ArrayLike, accel_bias: ArrayLike) -> tuple[Array, Array, Array]:
        """Return rotation (3, 3), velocity (3,) and position (3,) at new biases, to first order.

        The result is exact in the accelerometer bias.

        Raises:
            InputError: a bias is not three finite numbers.
        """
        return self._motion.corrected(
            as_vector("gyro_bias", gyro_bias), as_vector("accel_bias", accel_bias)
        )

    def needs_repropagation(
        self, gyro_bias: ArrayLike, *, accel_bias_sigma: float = 0.01
    ) -> Repropagation:
        """Tell if a new gyroscope bias is too far away for :meth:`corrected`.

        It is too far if the first-order error tilts gravity by more than the uncertainty of the
        accelerometer bias (``bundle.inertial.preintegration.preintegration`` has the closed form).

        Args:
            gyro_bias: (3,) rad/s.
            accel_bias_sigma: uncertainty of the accelerometer bias, in m/s^2.

        Returns:
            True or false as a condition, with its ``reason``.

        Raises:
            InputError: the values are not finite numbers, or the sigma is not above 0.
        """
        change = float(np.linalg.norm(as_vector("gyro_bias", gyro_bias) - self._gyro_bias))
        sigma = number("accel_bias_sigma", accel_bias_sigma, above=0)
        return Repropagation.of(change, self.duration, self._motion.turned, sigma)

    def predict(self, state: ArrayLike, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> Array:
        """Return the state (16,) at the end of the motion from a given state.

        Args:
            state: (16,) qx qy qz qw, position, velocity, gyroscope bias, accelerometer bias:
                world_from_imu, m, m/s, rad/s, m/s^2. The motion is corrected to its biases.
            gravity: (3,) m/s^2 in the world.

        Raises:
            InputError: a shape is wrong, or numbers are not finite.
        """
        return self._motion.predict(as_vector("state", state, 16), as_vector("gravity", gravity))

    @property
    def noise(self) -> ImuNoise:
        """Noise of the IMU."""
        return self._noise

    @property
    def rule(self) -> str:
        """Interpolation between samples, one of RULES."""
        return self._rule

    @property
    def gyro_bias(self) -> Array:
        """Gyroscope bias of the integration, (3,) rad/s."""
        return self._gyro_bias

    @property
    def accel_bias(self) -> Array:
        """Accelerometer bias of the integration, (3,) m/s^2."""
        return self._accel_bias

    @property
    def samples(self) -> Array:
        """Samples (n, 10): dt, gyro, accel, and accel at the interval's end.

        With midpoint, gyro is a mean.
        """
        return self._motion.samples

    @property
    def duration(self) -> float:
        """Duration in seconds."""
        return self._motion.duration

    @property
    def delta_rotation(self) -> Array:
        """Rotation (3, 3), the frame at the end relative to the frame at the start."""
        return self._motion.delta_rotation

    @property
    def delta_velocity(self) -> Array:
        """Change of velocity (3,) in m/s, without gravity."""
        return self._motion.delta_velocity

    @property
    def delta_position(self) -> Array:
        """Change of position (3,) in m, without gravity and the velocity at the start."""
        return self._motion.delta_position

    @property
    def covariance(self) -> Array:
        """Covariance (9, 9) of rotation (R Exp(d), radians), position (m) and velocity (m/s)."""
        return self._motion.covariance

    @property
    def combined_covariance(self) -> Array:
        """Covariance (15, 15): ``covariance``, then gyroscope and accelerometer bias at the end.

        The biases walk from those at the start with the densities of the noise, and affect the
        motion meanwhile. This is the covariance of the residual of :class:`bundle.ImuFactor`
        stacked with the change of the biases.
        """
        return self._motion.combined_covariance()

    @property
    def sqrt_information(self) -> Array:
        """Upper triangular W (9, 9), where W^T W is the inverse of the covariance.

        Raises:
            InputError: the covariance is not positive definite, for example without samples.
        """
        return self._motion.sqrt_information

    @property
    def d_rotation_d_gyro_bias(self) -> Array:
        """Jacobian J (3, 3): a bias change d makes the rotation R Exp(J d)."""
        return self._motion.d_rotation_d_gyro_bias

    @property
    def d_velocity_d_gyro_bias(self) -> Array:
        """Derivative (3, 3) of the velocity with respect to the gyroscope bias."""
        return self._motion.d_velocity_d_gyro_bias

    @property
    def d_velocity_d_accel_bias(self) -> Array:
        """Derivative (3, 3) of the velocity with respect to the accelerometer bias."""
        return self._motion.d_velocity_d_accel_bias

    @property
    def d_position_d_gyro_bias(self) -> Array:
        """Derivative (3, 3) of the position with respect to the gyroscope bias."""
        return self._motion.d_position_d_gyro_bias

    @property
    def d_position_d_accel_bias(self) -> Array:
        """Derivative (3, 3) of the position with respect to the accelerometer bias."""
        return self._motion.d_position_d_accel_bias

    def core_motion(self) -> _core.Preintegration:
        """Return a copy for the core; it does not contain later samples."""
        return self._motion.copy()

    def _display(self) -> Display:
        count = len(self.samples)
        sigmas = np.sqrt(np.maximum(np.diag(self.covariance), 0)).reshape(3, 3).max(axis=1)
        rotation = np.degrees(np.arccos(np.clip((np.trace(self.delta_rotation) - 1) / 2, -1, 1)))
        return Display(
            title=f"Preintegration: {count} samples in {self.duration:.6g} s, {self._rule}",
            facts=(
                ("rotation", f"{rotation:.3f} degrees, sigma {np.degrees(sigmas[0]):.2g}"),
                ("position", f"{_row(self.delta_position)} m, sigma {sigmas[1]:.2g}"),
                ("velocity", f"{_row(self.delta_velocity)} m/s, sigma {sigmas[2]:.2g}"),
                ("gyroscope bias", f"{_row(self._gyro_bias)} rad/s"),
                ("accelerometer bias", f"{_row(self._accel_bias)} m/s^2"),
            ),
        )


def _row(vector: Array) -> str:
    return " ".join(f"{value:.4g}" for value in vector)


def _restored(
    noise: ImuNoise, gyro_bias: Array, accel_bias: Array, rule: str, samples: Array
) -> Preintegration:
    motion = Preintegration(noise, gyro_bias, accel_bias, rule=rule)
    motion._motion.append_samples(samples)
    return motion


def propagate(
    state: ArrayLike,
    gyro: ArrayLike,
    accel: ArrayLike,
    dt: ArrayLike,
    *,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
    rule: str = "zero_order_hold",
) -> NDArray[np.float64]:
    """Return the states after each of n intervals, (n, 16).

    A state is qx qy qz qw of world_from_imu, position (m) and velocity (m/s) in the world,
    gyroscope bias (rad/s) and accelerometer bias (m/s^2). The biases are constant.

    Args:
        state: (16,) at the first sample.
        gyro: (n, 3) rad/s; by midpoint (n + 1, 3), a sample at each end of an interval.
        accel: m/s^2, specific force, likewise.
        dt: (n,) seconds, each above 0.
        gravity: (3,) m/s^2 in the world.
        rule: integration rule of :class:`bundle.Preintegration`.

    Raises:
        InputError: shapes do not fit, numbers are not finite, or a time is not above 0.
    """
    return _core.propagate(
        as_vector("state", state, 16),
        as_vector("gravity", gravity),
        choice("rule", rule, RULES),
        as_array("gyro", gyro),
        as_array("accel", accel),
        as_array("dt", dt),
    )


# Decision to repropagate samples when a new gyroscope bias is too far for first order.
#
# For a rotation at a constant rate through an angle Theta in the time T, and a bias change d
# perpendicular to the axis, the error of the first-order correction is
#
#     e = (Theta - sin Theta) / (2 Theta^2) (|d| T)^2,
#
# about w |d|^2 T^3 / 12 for a rate w, and at most (|d| T)^2 / (2 pi), at Theta = pi. The error is
# of second order: a change ten times as large gives an error a hundred times as large. A change
# along the axis causes no error. A rotation error e tilts gravity and leaks |g| e into the
# acceleration. It is harmless below the uncertainty b of the accelerometer bias: e < b / |g|. If
# the motion rotates by more than pi, or back and forth, the worst angle is assumed, Theta = pi.

GRAVITY = 9.81  # m/s^2


def first_order_error(angle: float, bias_change: float, duration: float) -> float:
    """Return the error of the first-order correction in radians.

    Args:
        angle: Theta, in radians, at least 0.
        bias_change: |d| perpendicular to the axis, in rad/s.
        duration: T, in seconds.
    """
    square = angle * angle
    if angle < 0.1:  # series of (Theta - sin Theta) / Theta^2: the difference loses digits
        coefficient = angle / 12 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    else:
        coefficient = (angle - math.sin(angle)) / (2 * square)
    return coefficient * (bias_change * duration) ** 2


@dataclass(frozen=True, repr=False)
class Repropagation(Displayed):
    """Decision to integrate samples again, true or false as a condition, with its reason.

    Attributes:
        needed: True if ``tilt`` exceeds ``limit``.
        tilt: error of the first-order correction, in radians.
        limit: tilt that leaks as much as the accelerometer bias, in radians.
        bias_change: |new gyroscope bias - that of the integration|, in rad/s.
        duration: duration of the samples, in seconds.
        turned: accumulated rotation angle of all samples, in radians.
    """

    needed: bool
    tilt: float
    limit: float
    bias_change: float
    duration: float
    turned: float

    @staticmethod
    def of(bias_change: float, duration: float, turned: float, accel_bias: float) -> Repropagation:
        """Return the decision for a bias change and an uncertainty of the accelerometer bias."""
        tilt = first_order_error(min(turned, math.pi), bias_change, duration)
        limit = accel_bias / GRAVITY
        return Repropagation(tilt > limit, tilt, limit, bias_change, duration, turned)

    def __bool__(self) -> bool:
        return self.needed

    @property
    def reason(self) -> str:
        """Reason with the numbers, in one sentence."""
        leak = self.tilt * GRAVITY
        return (
            f"a bias change of {self.bias_change:.3g} rad/s over {self.duration:.3g} s "
            f"tilts the first-order correction by {self.tilt:.3g} rad, which leaks "
            f"{leak:.3g} m/s^2 of gravity: {'above' if self.needed else 'within'} the "
            f"accelerometer bias of {self.limit * GRAVITY:.3g} m/s^2"
        )

    def _display(self) -> Display:
        return Display(
            title=f"Repropagation: {'needed' if self.needed else 'not needed'}",
            facts=(
                ("tilt", f"{self.tilt:.3g} rad, limit {self.limit:.3g}"),
                ("bias change", f"{self.bias_change:.3g} rad/s"),
                ("duration", f"{self.duration:.3g} s"),
                ("turned", f"{math.degrees(self.turned):.1f} degrees"),
            ),
        )


# Excitation of the accelerometer, on which the observability of scale depends.
#
# An accelerometer measures metres only while the acceleration changes. The standard deviation of
# |a| - |g| measures these changes. At rest, on a straight road or in a hover it contains only
# noise. Scale and accelerometer bias are then not separable.

HEALTHY, UNOBSERVABLE = 0.5, 0.05  # m/s^2


@dataclass(frozen=True, repr=False)
class Excitation(Displayed):
    """Change of the acceleration over some samples.

    Attributes:
        spread: standard deviation of |a| - |g|, in m/s^2.
        verdict: "healthy" above 0.5 m/s^2; "unobservable" below 0.05: the samples do not determine
            the scale, so hold it constant; "marginal" between.
        num_samples: number of samples.
    """

    spread: float
    verdict: str
    num_samples: int

    def _display(self) -> Display:
        return Display(
            title=f"Excitation: {self.verdict}",
            facts=(
                ("std(|a| - g)", f"{self.spread:.3g} m/s^2 of {self.num_samples} samples"),
                ("bounds", f"healthy above {HEALTHY:g}, unobservable below {UNOBSERVABLE:g}"),
            ),
        )


def excitation(accel: ArrayLike) -> Excitation:
    """Return the excitation of accelerometer samples, with a verdict on the scale.

    Args:
        accel: (n, 3) m/s^2, specific force, all samples of a window; at least 2.

    Raises:
        InputError: the shape is wrong, numbers are not finite, or there are fewer than 2 samples.
    """
    samples = as_array("accel", accel)
    if samples.ndim != 2 or samples.shape[1] != 3 or len(samples) < 2:
        raise InputError(f"accel: expected shape (n, 3) with n of 2 or more, found {samples.shape}")
    spread = float(np.sqrt(np.einsum("ij,ij->i", samples, samples)).std())
    check_values("accel", samples, Declared(("n", 3), "finite"))
    if spread > HEALTHY:
        verdict = "healthy"
    else:
        verdict = "unobservable" if spread < UNOBSERVABLE else "marginal"
    return Excitation(spread, verdict, len(samples))
