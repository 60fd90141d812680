"""A small sequence, and the lines of its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bundle.io.sequences.sequence_folder import save_sequence
from bundle.model.sequence.calibration import Calibration, ImuNoise
from bundle.model.sequence.sequence import Sequence

NOISE = ImuNoise(1.7e-4, 2e-3, 1.9e-5, 3e-3)
START = 1_403_715_273_262_142_976  # ns, more digits than a double has


def calibration(**changes: Any) -> Calibration:
    settings: dict[str, Any] = {
        "camera_from_imu": (0.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3),
        "noise": NOISE,
        "focal": 400.0,
    }
    return Calibration(**(settings | changes))


def sequence(**changes: Any) -> Sequence:
    """Two seconds of noise at 200 Hz, 21 images of the same five tracks."""
    rng = np.random.default_rng(3)
    imu = START + 5_000_000 * np.arange(401)
    images = START + 100_000_000 * np.arange(21)
    settings: dict[str, Any] = {
        "imu_timestamps_ns": imu,
        "gyro": rng.normal(0, 0.01, (401, 3)),
        "accel": rng.normal([0, 0, 9.81], 0.02, (401, 3)),
        "track_timestamps_ns": np.repeat(images, 5),
        "track_ids": np.tile([3, 4, 7, 8, 9], 21),
        "xy": np.tile(rng.uniform(-0.5, 0.5, (5, 2)), (21, 1)) + rng.normal(0, 1e-4, (105, 2)),
        "calibration": calibration(),
    }
    return Sequence(**(settings | changes))


def edited(folder: Path, name: str, line: int, text: str | None) -> Path:
    """Write the sequence with one line of one file replaced, or left out."""
    save_sequence(sequence(), folder)
    lines = (folder / name).read_text().splitlines()
    lines[line - 1 : line] = [] if text is None else [text]
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder
