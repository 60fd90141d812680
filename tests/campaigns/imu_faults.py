"""Is a wrong IMU called good, and is its fault named?

``python -m tests.campaigns.imu_faults [--bases NAME ...] [--only NAME ...]`` puts one fault at a
time into EuRoC V1_01 (30 s) and into six synthetic flights, and runs ``bundle vio`` as a user does.
A run is wrong if it ends with exit 0 and a position error above 0.15 m (V1_01) or 0.3 m (flights),
with a traceback, or with exit 1 without report or trajectory. Its cause is named if the text
matches the pattern of the fault. Sequences without a fault must end with exit 0 and without a
warning. Bases are V1_01, MOTION SEED (``"room 31"``; ``"phone 34"`` has the sensors of a phone) or
all of them; each base gets each fault.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bundle.cli.main import main as bundle
from bundle.io.sequences.sequence_folder import read_track_csv, save_sequence
from bundle.io.sequences.trajectory_files import save_tum
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.synthetic_flight import synthesize_flight

Array = np.ndarray[Any, Any]
Fault = Callable[[Sequence], Sequence]

AT = 12.0  # s after the first sample
FLIGHTS = ("loop 31", "room 31", "loop 32", "room 32", "loop 33", "phone 34")
PHONE = {"motion": "room", "imu_rate": 100, "imu_noise_scale": 2.0, "pixel_noise": 1.0}
GOOD_REAL = 0.15
GOOD_FLIGHT = 0.3


def rows(sequence: Sequence, begin: float, end: float) -> Array:
    seconds = 1e-9 * (sequence.imu_timestamps_ns - sequence.imu_timestamps_ns[0])
    return np.flatnonzero((seconds >= begin) & (seconds < end))


def samples(change: Callable[[Array, Sequence], None]) -> Fault:
    """Return a fault that changes (n, 6) rates and forces in place."""

    def apply(sequence: Sequence) -> Sequence:
        values = np.column_stack([sequence.gyro, sequence.accel])
        change(values, sequence)
        return replace(sequence, gyro=values[:, :3].copy(), accel=values[:, 3:].copy())

    return apply


def matrix(gyro: Any, accel: Any) -> Fault:
    """Return a fault that multiplies rates and forces by matrices or diagonals."""
    pair = [np.diag(m) if np.ndim(m) == 1 else np.asarray(m, float) for m in (gyro, accel)]
    return lambda s: replace(s, gyro=s.gyro @ pair[0].T, accel=s.accel @ pair[1].T)


def spike(column: int, size: float, count: int = 1) -> Fault:
    def change(values: Array, sequence: Sequence) -> None:
        first = rows(sequence, AT, 99)[0]
        values[first : first + count, column] = size

    return samples(change)


def hold(seconds: float, columns: slice, value: float | None = None) -> Fault:
    def change(values: Array, sequence: Sequence) -> None:
        where = rows(sequence, AT, AT + seconds)
        values[where, columns] = values[where[0], columns] if value is None else value

    return samples(change)


def clip(columns: slice, limit: float) -> Fault:
    def change(values: Array, _: Sequence) -> None:
        values[:, columns] = np.clip(values[:, columns], -limit, limit)

    return samples(change)


def shift(column: int, size: float, after: float = 0.0) -> Fault:
    def change(values: Array, sequence: Sequence) -> None:
        values[rows(sequence, after, 1e9), column] += size

    return samples(change)


def warming(rate: float, force: float, seconds: float = 10.0) -> Fault:
    """Return a fault that adds biases which approach their sizes exponentially."""

    def change(values: Array, sequence: Sequence) -> None:
        time = 1e-9 * (sequence.imu_timestamps_ns - sequence.imu_timestamps_ns[0])
        values[:, [1, 3]] += np.outer(1 - np.exp(-time / seconds), [rate, force])

    return samples(change)


def noise(factor: float) -> Fault:
    def change(values: Array, sequence: Sequence) -> None:
        stated = sequence.calibration.noise
        sigma = np.repeat([stated.gyro_noise_density, stated.accel_noise_density], 3)
        values += np.random.default_rng(7).normal(size=values.shape) * sigma * factor * 200**0.5

    return samples(change)


def calibrated(**changes: Any) -> Fault:
    return lambda s: replace(s, calibration=replace(s.calibration, **changes))


def turned(axis: int, degrees: float) -> Fault:
    def apply(sequence: Sequence) -> Sequence:
        pose = np.array(sequence.calibration.camera_from_imu)
        turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis])
        pose[:4] = (turn * Rotation.from_quat(pose[:4])).as_quat()
        return calibrated(camera_from_imu=tuple(pose))(sequence)

    return apply


def inverted(sequence: Sequence) -> Sequence:
    pose = np.array(sequence.calibration.camera_from_imu)
    back = Rotation.from_quat(pose[:4]).inv()
    return calibrated(camera_from_imu=(*back.as_quat(), *-back.apply(pose[4:])))(sequence)


def late(milliseconds: float, after: float = 0.0) -> Fault:
    def apply(sequence: Sequence) -> Sequence:
        stamps = sequence.track_timestamps_ns.copy()
        moved = stamps >= sequence.imu_timestamps_ns[0] + round(1e9 * after)
        stamps[moved] += round(1e6 * milliseconds)
        return replace(sequence, track_timestamps_ns=stamps)

    return apply


def drifting(ppm: float) -> Fault:
    def apply(sequence: Sequence) -> Sequence:
        first = sequence.imu_timestamps_ns[0]
        stamps = sequence.track_timestamps_ns - first
        return replace(sequence, track_timestamps_ns=first + np.int64(stamps * (1 + 1e-6 * ppm)))

    return apply


def jitter(sequence: Sequence) -> Sequence:
    stamps, image = np.unique(sequence.track_timestamps_ns, return_inverse=True)
    moved = stamps + np.int64(np.random.default_rng(7).normal(0, 5e6, len(stamps)))
    return replace(sequence, track_timestamps_ns=moved[image])


def without(keep: Callable[[Sequence], Array]) -> Fault:
    def apply(s: Sequence) -> Sequence:
        kept = keep(s)
        return replace(
            s, imu_timestamps_ns=s.imu_timestamps_ns[kept], gyro=s.gyro[kept], accel=s.accel[kept]
        )

    return apply


def written_twice(seconds: float) -> Fault:
    """Return a fault that puts a block of rows in place of those that follow it."""

    def change(values: Array, sequence: Sequence) -> None:
        block = rows(sequence, AT, AT + seconds)
        values[block + len(block)] = values[block]

    return samples(change)


def focal(factor: float) -> Fault:
    def apply(sequence: Sequence) -> Sequence:
        given = sequence.calibration
        if given.camera_model is None:
            return replace(sequence, xy=sequence.xy / factor)
        count = 2 if given.camera_model in ("PINHOLE", "OPENCV") else 1
        scaled = [factor * value for value in given.camera_params[:count]]
        return calibrated(camera_params=(*scaled, *given.camera_params[count:]))(sequence)

    return apply


def gap(seconds: float) -> Fault:
    return without(lambda s: np.setdiff1d(np.arange(len(s.gyro)), rows(s, AT, AT + seconds)))


def every(count: int) -> Fault:
    return without(lambda s: np.arange(0, len(s.gyro), count))


def noise_stated(factor: float) -> Fault:
    def apply(sequence: Sequence) -> Sequence:
        stated = sequence.calibration.noise
        wrong = type(stated)(*(factor * value for value in stated.astuple()[:4]))
        return calibrated(noise=wrong)(sequence)

    return apply


GYRO, ACCEL, BOTH = slice(0, 3), slice(3, 6), slice(0, 6)
ONE = (1, 1, 1)
ROTATION = "camera_from_imu|axes"
CLOCK = "time offset|clock|stamps"
FAULTS: dict[str, tuple[Fault, str]] = {
    "gyro spike 30": (spike(1, 30.0), "gyroscope jumped"),
    "gyro spike 3": (spike(1, 3.0), "gyroscope jumped"),
    "gyro spikes 10 x 4": (spike(0, 10.0, 4), "gyroscope jumped"),
    "accel spike 160": (spike(3, 160.0), "accelerometer jumped"),
    "accel spike 50": (spike(4, 50.0), "accelerometer jumped"),
    "accel spikes -80 x 3": (spike(5, -80.0, 3), "accelerometer jumped"),
    **{
        f"frozen {name} {seconds:g} s": (hold(seconds, columns), f"{word}.* repeated one sample")
        for name, columns, word in (
            ("both", BOTH, "gyroscope"), ("gyro", GYRO, "gyroscope"),
            ("accel", ACCEL, "accelerometer"),
        )
        for seconds in (0.1, 0.5, 1.0, 3.0, 99.0)
    },
    **{
        f"zero {name} {seconds:g} s": (hold(seconds, columns, 0.0), "was 0 on all axes")
        for name, columns in (("both", BOTH), ("gyro", GYRO), ("accel", ACCEL))
        for seconds in (0.2, 1.0)
    },
    "accel clipped 10": (clip(ACCEL, 10.0), "end of the sensor's range"),
    "accel clipped 9.9": (clip(ACCEL, 9.9), "end of the sensor's range"),
    "gyro clipped 0.4": (clip(GYRO, 0.4), "end of the sensor's range"),
    "gyro reversed": (matrix((-1, -1, -1), ONE), "axes -x -y -z"),
    "gyro z reversed": (matrix((1, 1, -1), ONE), r"axes \+x \+y -z"),
    "accel reversed": (matrix(ONE, (-1, -1, -1)), "accelerometer.*reversed"),
    "accel x reversed": (matrix(ONE, (-1, 1, 1)), "accelerometer|contradict"),
    "accel y reversed": (matrix(ONE, (1, -1, 1)), "accelerometer|contradict"),
    "y of both reversed": (matrix((1, -1, 1), (1, -1, 1)), "axes"),
    "x and y swapped": (matrix(*2 * ([[0, 1, 0], [1, 0, 0], [0, 0, 1]],)), "axes"),
    "turned about z": (matrix(*2 * ([[0, -1, 0], [1, 0, 0], [0, 0, 1]],)), ROTATION),
    "half a turn about x": (matrix(*2 * ((1, -1, -1),)), ROTATION),
    "degrees": (matrix(np.full(3, 180 / np.pi), ONE), "degrees"),
    "g": (matrix(ONE, np.full(3, 1 / 9.80665)), "probably g"),
    "gyro 3 % too large": (matrix(np.full(3, 1.03), ONE), "scale of the gyroscope"),
    "accel 3 % too large": (matrix(ONE, np.full(3, 1.03)), "scale of the accelerometer"),
    "accel bias 1": (shift(4, 1.0), "bias"),
    "accel bias jumps": (shift(3, 0.5, 15.0), "bias|contradict"),
    "gyro bias jumps": (shift(1, 0.1, 15.0), "gyro.* bias"),
    **{
        f"warms up by {rate:g} and {force:g}": (warming(rate, force), "bias|rotations of tracks")
        for rate, force in ((0.05, 0.3), (0.03, 0.2), (0.03, 0.0), (0.0, 0.8))
    },
    "noise x 30": (noise(30), "noise"),
    "noise x 100": (noise(100), "noise"),
    "noise stated x 100": (noise_stated(100), "noise"),
    "noise stated / 100": (noise_stated(0.01), "noise|contradict"),
    **{f"camera turned {d} about {'xyz'[a]}": (turned(a, d), ROTATION)
       for a, d in ((0, 5), (1, 5), (2, 10), (0, 30), (1, 90), (2, 180))},
    "camera_from_imu inverted": (inverted, ROTATION),
    **{f"images {ms:+d} ms": (late(ms), CLOCK) for ms in (-100, -20, 20, 100, 300)},
    "images jump 200 ms": (late(200, 12.0), "gap|stamps|far from"),
    "clock drifts 1 %": (drifting(1e4), CLOCK),
    "clock drifts 0.1 %": (drifting(1e3), CLOCK),
    "jitter 5 ms": (jitter, "stamps of images"),
    "gap 95 ms": (gap(0.095), "gap"),
    "gap 200 ms": (gap(0.2), "gap"),
    "50 Hz": (every(4), "imu_rate"),
    "0.25 s written twice": (written_twice(0.25), "repeated .* earlier samples"),
    "gyro z dead": (matrix((1, 1, 0), ONE), "found 0 on z"),
    "gyro x and y swapped": (matrix([[0, 1, 0], [1, 0, 0], [0, 0, 1]], ONE), r"axes \+y \+x"),
    "focal length 15 % too large": (focal(1.15), "focal length"),
}  # fmt: skip


def base(name: str, folder: Path) -> tuple[Sequence, Path, float]:
    """Return sequence, true poses and largest error of a base."""
    if name == "V1_01":
        data = Path(os.environ.get("BUNDLE_DATA", "../shared/data")) / "vio"
        real = read_track_csv(data / "euroc_V1_01_tracks_imu_30s.csv")
        return real, data / "euroc_V1_01_ground_truth.csv", GOOD_REAL
    motion, seed = name.split()
    given = PHONE if motion == "phone" else {"motion": motion}
    flight = synthesize_flight(seed=int(seed), **given)
    truth = folder / f"{motion}{seed}.tum"
    save_tum(truth, flight.ground_truth.timestamps_ns, flight.ground_truth.states)
    return flight.sequence, truth, GOOD_FLIGHT


def run(sequence: Sequence, truth: Path, folder: Path) -> dict[str, Any]:
    """Run `bundle vio`; return exit code, text, error and the files that it wrote."""
    source, target, report = folder / "s", folder / "x.tum", folder / "x.json"
    for file in (target, report):
        file.unlink(missing_ok=True)
    save_sequence(sequence, source)
    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        code = bundle(
            ["vio", str(source), "-o", str(target), "--json", str(report), "--quiet", "--verbose",
             "--ground-truth", str(truth), "--time-budget", "10"]
        )  # fmt: skip
    ate, warnings, message = None, [], ""
    if report.exists():
        content = json.loads(report.read_text())
        ate = (content["error"] or {}).get("ate")
        warnings, message = content["summary"]["warnings"], content["summary"]["message"]
    said = " ".join([message, *warnings]) if report.exists() else text.getvalue()
    return {
        "code": code, "ate": ate, "said": said, "warnings": warnings,
        "has_files": report.exists() and target.exists(),
    }  # fmt: skip


def verdict(found: dict[str, Any], pattern: str, largest: float) -> tuple[bool, bool]:
    """Return True for a run that is not called good wrongly, and for a cause that is named."""
    is_good = found["ate"] is not None and found["ate"] <= largest
    right = is_good if found["code"] == 0 else found["code"] == 2 or found["has_files"]
    return right, re.search(pattern, found["said"], re.IGNORECASE | re.DOTALL) is not None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bases", nargs="*", default=["V1_01", *FLIGHTS])
    parser.add_argument("--only", nargs="*", default=())
    arguments = parser.parse_args()
    chosen = {
        name: fault
        for name, fault in FAULTS.items()
        if not arguments.only or name in arguments.only
    }
    wrong = named = count = alarms = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for place in arguments.bases:
            sequence, truth, largest = base(place, folder)
            clean = run(sequence, truth, folder)
            is_alarm = clean["code"] != 0 or bool(clean["warnings"])
            alarms += is_alarm
            print(
                f"{place}: {clean['ate']:.3f} m {clean['said'] if is_alarm else ''}",
                flush=True,
            )
            for name, (fault, pattern) in chosen.items():
                began = time.perf_counter()
                try:
                    faulty = fault(sequence)
                except ValueError as error:  # the sequence itself refuses, as its file would
                    right, is_named = (
                        True,
                        re.search(pattern, str(error), re.IGNORECASE) is not None,
                    )
                    found = {"code": 2, "ate": None, "said": str(error)}
                else:
                    found = run(faulty, truth, folder)
                    right, is_named = verdict(found, pattern, largest)
                count, wrong, named = count + 1, wrong + (not right), named + is_named
                ate = "-" if found["ate"] is None else f"{found['ate']:.3f}"
                marks = ("" if right else " WRONG") + ("" if is_named else " UNNAMED")
                print(
                    f"  {name:26} exit {found['code']} {ate:>8} m "
                    f"{time.perf_counter() - began:4.1f} s{marks}"
                    + (f": {found['said'][:300]}" if marks else ""),
                    flush=True,
                )
    print(
        f"{count} runs: {wrong} called good wrongly, {named} named; {alarms} alarms on clean ones"
    )
    return int(wrong > 0 or alarms > 0)


if __name__ == "__main__":
    raise SystemExit(main())
