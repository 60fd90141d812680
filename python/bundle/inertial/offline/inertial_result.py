"""Samples of an IMU, and the result of an adjustment with them."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number as rounded
from bundle.georeference.similarity import Similarity
from bundle.inertial.offline.imu_agreement import Agreement, ClockOffset
from bundle.inertial.offline.imu_findings import ImuFinding
from bundle.inertial.offline.inertial_start import InertialStart
from bundle.solving.result import Result

Array = NDArray[np.float64]


class ImuSamples(NamedTuple):
    """Samples of an IMU."""

    timestamps_ns: NDArray[np.int64]  # (m,) int64, ascending
    gyro: Array  # (m, 3) rad/s
    accel: Array  # (m, 3) specific force, m/s^2


@dataclass(frozen=True, eq=False, repr=False)
class InertialAdjustment(Displayed):
    """Result of an adjustment with an IMU."""

    result: Result  # result of the last solve, in metres with z up, without velocities and biases
    similarity: Similarity  # similarity from the input to the start
    scale: float  # factor between the positions of the input and of the result
    start: InertialStart  # scale, gravity and biases of the start
    timestamps_ns: NDArray[np.int64]  # (n,) times of the images, or of the frames of a rig
    velocities: Array  # (n, 3) of the IMU at these times in the world, m/s
    gyro_biases: Array  # (n, 3) rad/s
    accel_biases: Array  # (n, 3) m/s^2
    imu_cost: float  # cost of the motions in the result
    noise_scale: float  # factor on the noise densities
    num_solves: int  # number of solves
    clock: ClockOffset  # offset of the clocks; a clear offset was added to the times of images
    imu_samples: str  # kind of the samples: "instant" or "interval"
    # degrees of freedom of the world that motions and priors leave: 4 (position and heading)
    # without priors, 3 with headings, 0 with positions
    gauge_freedom: int
    agreement: Agreement  # chi2 of images and IMU, as a whole and by interval
    findings: tuple[ImuFinding, ...]  # on samples, calibration, clocks; a problem: not usable

    @property
    def headline(self) -> tuple[list[str], list[str]]:
        """Sentences before and after those of the solve."""
        problems = [one for one in self.findings if one.is_problem]
        if not problems:
            return [], [self.sentence]
        seconds = problems[0].evidence["seconds"]
        return [f"Not usable: images and IMU contradict each other, most at {seconds:.2f} s."], []

    @property
    def sentence(self) -> str:
        """Describe scale, vertical and biases in words."""
        gyro, accel = (
            float(np.linalg.norm(biases.mean(axis=0)))
            for biases in (self.gyro_biases, self.accel_biases)
        )
        clock = ""
        if self.imu_samples == "interval":
            clock = " Its samples are means over the interval that follows their stamp."
        if self.clock.is_clear:
            clock += (
                f" The clocks differ by {1e3 * self.clock.seconds:.2g} +- "
                f"{1e3 * self.clock.sigma:.1g} ms; the result is corrected for it."
            )
        return (
            f"In metres, z up, by the IMU: the input is scaled by {rounded(self.scale)}; mean "
            f"biases {gyro:.2g} rad/s and {accel:.2g} m/s^2.{clock}"
        )

    def asdict(self) -> dict[str, Any]:
        """Return the content of the JSON report."""
        return {
            "scale": self.scale,
            "similarity": self.similarity.asdict(),
            "start_scale_sigma": self.start.scale_sigma,
            "imu_cost": self.imu_cost,
            "noise_scale": self.noise_scale,
            "gyro_bias": self.gyro_biases.mean(axis=0).tolist(),
            "accel_bias": self.accel_biases.mean(axis=0).tolist(),
            "num_solves": self.num_solves,
            "imu_samples": self.imu_samples,
            "gauge_freedom": self.gauge_freedom,
            "clock_offset": self.clock.seconds,
            "clock_offset_sigma": self.clock.sigma if math.isfinite(self.clock.sigma) else None,
            "clock_offset_used": self.clock.is_clear,
            **self.agreement.asdict(),
        }

    def _display(self) -> Display:
        return Display(title=self.sentence, facts=(("solve", self.result.outcome),))
