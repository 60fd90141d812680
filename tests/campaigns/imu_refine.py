"""Faults of IMU, calibration and clocks in adjustments of reconstructions with an IMU.

Each fault is planted in a seeded flight, whose reconstruction is then adjusted. A run ends in one
of four ways: "refused" (an error names the cause), "not usable", "finding" or "silent". It is wrong
if it is silent although the scale is off by more than 3 %, the vertical by more than 1 degree, or
the path by more than 3 times that of the clean flight; or if a clean flight is not silent. Samples
with more noise hold less: scale and path are then relative to those with the right noise.

python -m tests.campaigns.imu_refine [FLIGHTS] [SEED]
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.inertial.offline.imu_adjustment import adjust_with_imu
from bundle.inertial.offline.inertial_result import ImuSamples
from bundle.inertial.vio.trajectory_comparison import compare_trajectories, states_at
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.sequence.calibration import Calibration
from tests.inertial.offline.models import model_of, world_from_imu

OPTIONS = bundle.SolveOptions(loss="cauchy", max_num_iterations=30)
MOST_SCALE, MOST_TILT, MOST_PATH = 0.03, 1.0, 3.0


class Recording(NamedTuple):
    """Samples, times of images and calibration of a flight."""

    stamps: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    images: np.ndarray
    calibration: Calibration

    @property
    def seconds(self) -> np.ndarray:
        """Times of the samples since the first."""
        return 1e-9 * (self.stamps - self.stamps[0])

    def arm(self, pose: np.ndarray) -> Recording:
        """Return the recording with another camera_from_imu."""
        changed = dataclasses.replace(self.calibration, camera_from_imu=tuple(pose.tolist()))
        return self._replace(calibration=changed)

    def without(self, dropped: np.ndarray) -> Recording:
        """Return the recording without some samples."""
        kept = ~dropped
        return self._replace(stamps=self.stamps[kept], gyro=self.gyro[kept], accel=self.accel[kept])


Fault = Callable[[Recording, np.random.Generator], Recording]


def turned(axis: int, degrees: float) -> Fault:
    """camera_from_imu that is off about an axis."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        pose = np.array(given.calibration.camera_from_imu)
        turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis])
        return given.arm(np.r_[(turn * Rotation.from_quat(pose[:4])).as_quat(), pose[4:]])

    return fault


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """camera_from_imu as a function of the right one."""
    return lambda given, _: given.arm(change(np.array(given.calibration.camera_from_imu)))


def inverted(pose: np.ndarray) -> np.ndarray:
    """imu_from_camera."""
    turn = Rotation.from_quat(pose[:4]).inv()
    return np.r_[turn.as_quat(), -turn.apply(pose[4:])]


def axes(gyro: object, accel: object) -> Fault:
    """Samples along other axes, or of another size."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        matrices = (np.asarray(one, float) * np.eye(3) if np.ndim(one) < 2 else np.asarray(one)
                    for one in (gyro, accel))  # fmt: skip
        by_gyro, by_accel = matrices
        return given._replace(gyro=given.gyro @ by_gyro.T, accel=given.accel @ by_accel.T)

    return fault


def added(gyro: object, accel: object, since: float = 0.0) -> Fault:
    """Biases from a time on."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        late = (given.seconds >= since)[:, None]
        return given._replace(
            gyro=given.gyro + late * np.asarray(gyro), accel=given.accel + late * np.asarray(accel)
        )

    return fault


def warming(gyro: object, accel: object, seconds: float = 8.0) -> Fault:
    """Biases that approach their sizes exponentially."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        share = 1 - np.exp(-given.seconds / seconds)[:, None]
        return given._replace(
            gyro=given.gyro + share * np.asarray(gyro),
            accel=given.accel + share * np.asarray(accel),
        )

    return fault


def noisy(factor: float) -> Fault:
    """More noise of the samples than the calibration has."""

    def fault(given: Recording, rng: np.random.Generator) -> Recording:
        root = np.sqrt(given.calibration.imu_rate)
        sizes = root * factor * np.array(given.calibration.noise.astuple()[:2])
        return given._replace(
            gyro=given.gyro + sizes[0] * rng.normal(size=given.gyro.shape),
            accel=given.accel + sizes[1] * rng.normal(size=given.accel.shape),
        )

    return fault


def calibrated(factor: float) -> Fault:
    """Noise of the calibration that is not that of the samples."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        noise = given.calibration.noise.scaled(factor)
        return given._replace(calibration=dataclasses.replace(given.calibration, noise=noise))

    return fault


def constant(begin: float, end: float, sensors: str, *, zero: bool = False) -> Fault:
    """Samples that a sensor repeats, or zeros."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        rows = (given.seconds > begin) & (given.seconds < end)
        changed = {}
        for name in sensors.split():
            values = np.array(getattr(given, name))
            values[rows] = 0.0 if zero else values[np.argmax(rows)]
            changed[name] = values
        return given._replace(**changed)

    return fault


def clipped(sensor: str, bound: float) -> Fault:
    """Samples of a sensor whose range ends too early."""
    return lambda given, _: given._replace(
        **{sensor: np.clip(getattr(given, sensor), -bound, bound)}
    )


def spike(sensor: str, axis: int, value: float) -> Fault:
    """One wrong sample."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        values = np.array(getattr(given, sensor))
        values[len(values) // 2, axis] = value
        return given._replace(**{sensor: values})

    return fault


def timed(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Fault:
    """Other times of images, from seconds since the first sample."""

    def fault(given: Recording, rng: np.random.Generator) -> Recording:
        times = change(1e-9 * (given.images - given.stamps[0]), rng)
        return given._replace(images=given.stamps[0] + np.round(1e9 * times).astype(np.int64))

    return fault


def gaps(begins: np.ndarray, seconds: float) -> Fault:
    """Samples that are missing."""

    def fault(given: Recording, _: np.random.Generator) -> Recording:
        since = given.seconds[:, None] - begins
        return given.without(((since > 0) & (since < seconds)).any(axis=1))

    return fault


SWAP = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
TURN = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]

FAULTS: dict[str, Fault] = {
    **{f"turned {size} {'xyz'[k]}": turned(k, size) for k in range(3) for size in (2.0, 5.0, 10.0)},
    **{
        f"arm 10 cm {'xyz'[k]}": posed(lambda pose, k=k: pose + 0.1 * np.eye(7)[4 + k])
        for k in range(3)
    },
    "arm in mm": posed(lambda pose: pose * [1, 1, 1, 1, 1e3, 1e3, 1e3]),
    "inverted": posed(inverted),
    "order w x y z": posed(lambda pose: pose[[3, 0, 1, 2, 4, 5, 6]]),
    "axes exchanged": axes(SWAP, SWAP),
    "axes turned": axes(TURN, TURN),
    "axes y z reversed": axes([1, -1, -1], [1, -1, -1]),
    "axis y reversed": axes([1, -1, 1], [1, -1, 1]),
    "gyro reversed": axes(-1, 1),
    "gyro z reversed": axes([1, 1, -1], 1),
    "gyro in degrees": axes(np.degrees(1), 1),
    "gyro 3 % large": axes(1.03, 1),
    "accel reversed": axes(1, -1),
    "accel x reversed": axes(1, [-1, 1, 1]),
    "accel in g": axes(1, 1 / 9.81),
    "accel 3 % large": axes(1, 1.03),
    "sensors exchanged": lambda given, _: given._replace(gyro=given.accel, accel=given.gyro),
    "gyro bias 0.1": added([0, 0.1, 0], 0),
    "accel bias 0.5": added(0, [0.5, 0, 0]),
    "accel bias 1": added(0, [0, 1.0, 0]),
    "accel bias jumps": added(0, [0.5, 0, 0], 10.0),
    "accel bias steps": added(0, [0, 0.2, 0.1], 8.0),
    "gyro bias steps": added([0, 0.01, 0], 0, 6.0),
    "accel warms up": warming([0, 0, 0], [0.2, 0.2, 0.1]),
    "gyro warms up": warming([0.01, 0.02, 0], [0, 0, 0]),
    "noise 10": noisy(10),
    "noise 30": noisy(30),
    "calibrated noise 100": calibrated(100),
    "calibrated noise 0.01": calibrated(0.01),
    "frozen 0.5 s": constant(8, 8.5, "gyro accel"),
    "frozen 2 s": constant(8, 10, "gyro accel"),
    "frozen": constant(8, 99, "gyro accel"),
    "gyro frozen": constant(8, 99, "gyro"),
    "accel frozen": constant(8, 99, "accel"),
    "zero 1 s": constant(8, 9, "gyro accel", zero=True),
    "accel clipped at 10": clipped("accel", 10.0),
    "accel clipped at 9.9": clipped("accel", 9.9),
    "gyro clipped at 0.4": clipped("gyro", 0.4),
    "spike of the gyro": spike("gyro", 1, 30.0),
    "spike of the accel": spike("accel", 0, 160.0),
    **{
        f"offset {1e3 * size:g} ms": timed(lambda t, _, size=size: t + size)
        for size in (-0.05, -0.005, 0.005, 0.02, 0.05, 2.0)
    },
    "drift 0.1 %": timed(lambda t, _: 1.001 * t),
    "jitter 5 ms": timed(lambda t, rng: np.sort(t + rng.normal(0, 5e-3, len(t)))),
    "gap 50 ms": gaps(np.array([8.0]), 0.05),
    "gap 200 ms": gaps(np.array([8.0]), 0.2),
    "gaps of 95 ms": gaps(np.arange(4, 18, 2.0), 0.095),
    "a fifth lost": lambda given, rng: given.without(
        np.r_[False, rng.random(len(given.stamps) - 2) < 0.2, False]
    ),
    "50 Hz": lambda given, _: given.without(np.arange(len(given.stamps)) % 4 > 0),
    "half": lambda given, _: given.without(np.arange(len(given.stamps)) > len(given.stamps) // 2),
}


RIGHT_SCALES = {"noise 10": 10.0, "noise 30": 30.0}


class Outcome(NamedTuple):
    """End of a run: how it ends, its first words, and its errors if there is a result."""

    end: str
    words: str
    scale: float = np.nan
    tilt: float = np.nan
    path: float = np.nan

    def is_wrong(self, clean: float, right_scale: float = 1.0) -> bool:
        """Return True for a wrong result without a word."""
        return self.end == "silent" and (
            abs(self.scale / right_scale - 1) > MOST_SCALE
            or self.tilt > MOST_TILT
            or self.path > MOST_PATH * clean
        )


class Scene:
    """A flight and its reconstruction."""

    def __init__(self, seed: int, duration: float = 16.0) -> None:
        motion = ("loop", "room")[seed % 2]
        flight = bundle.synthesize_flight(motion=motion, duration=duration, seed=seed)
        self.truth, sequence = flight.ground_truth, flight.sequence
        problem, stamps = model_of(sequence, self.truth, 4, noise=0.1, seed=seed)
        inner = np.abs(stamps - (stamps[0] + stamps[-1]) / 2) < 0.5e9 * (duration - 1.0)
        self.problem = problem.select(images=inner).problem
        stamps = stamps[inner]
        self.seed, self.images = seed, stamps
        self.recording = Recording(
            sequence.imu_timestamps_ns, sequence.gyro, sequence.accel, stamps, sequence.calibration
        )

    def run(self, fault: Fault | None, noise_scale: float | None = None) -> Outcome:
        """Plant a fault and adjust."""
        given = self.recording
        if fault is not None:
            given = fault(given, np.random.default_rng(self.seed))
        try:
            found = adjust_with_imu(
                self.problem, ImuSamples(given.stamps, given.gyro, given.accel), given.images,
                given.calibration.camera_from_imu, given.calibration.noise, OPTIONS,
                imu_noise_scale=noise_scale,
            )  # fmt: skip
        except InputError as error:
            return Outcome("refused", str(error))
        words = "; ".join(one.sentence for one in found.findings)
        if not found.result.summary.is_solution_usable:
            return Outcome("not usable", words)
        arm = self.recording.calibration.camera_from_imu
        poses = world_from_imu(found.result.problem, arm)
        error = compare_trajectories(
            Trajectory(self.images, np.hstack([poses, np.zeros((len(poses), 9))])), self.truth
        )
        up, right = (
            Rotation.from_quat(one[:, :4]).inv().apply([0, 0, 1.0])
            for one in (poses, states_at(self.truth, self.images))
        )
        tilt = np.degrees(np.arccos(np.clip((up * right).sum(axis=1), -1, 1))).mean()
        end = "finding" if found.findings else "silent"
        return Outcome(end, words, error.scale, float(tilt), error.ate_yaw)


def campaign(flights: int, seed: int, names: tuple[str, ...] = ()) -> list[str]:
    """Run all faults on flights; return the lines of what is wrong."""
    wrong = []
    for k in range(seed, seed + flights):
        scene = Scene(k)
        clean = scene.run(None)
        print(
            f"{k} {'clean':22} {clean.end:10} {clean.scale:.4f} {clean.tilt:.2f} {clean.path:.4f}"
        )
        if clean.end != "silent":
            wrong.append(f"{k} clean: {clean.end} {clean.words}")
        for name in names or FAULTS:
            one = scene.run(FAULTS[name])
            noise = RIGHT_SCALES.get(name)
            best = clean if noise is None else scene.run(FAULTS[name], noise)
            is_wrong = one.is_wrong(best.path, 1.0 if noise is None else best.scale)
            mark = "WRONG" if is_wrong else ""
            numbers = f"{one.scale:.4f} {one.tilt:.2f} {one.path:.4f}"
            print(f"{k} {name:22} {one.end:10} {numbers} {one.words[:120]} {mark}", flush=True)
            if mark:
                wrong.append(f"{k} {name}: {numbers}")
    return wrong


if __name__ == "__main__":
    flights, seed = (int(word) for word in (sys.argv[1:] + ["2", "100"][len(sys.argv) - 1 :])[:2])
    found = campaign(flights, seed)
    print(f"{len(found)} wrong", *found, sep="\n")
