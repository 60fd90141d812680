"""Ten thousand keyframes: does a window stay bounded, and its prior healthy?

``python -m tests.campaigns.long_window [KEYFRAMES [FORM PRECISION]]`` follows a long seeded flight
and prints per thousand keyframes: time and rows per keyframe, memory, the prior's ratio (median),
definiteness and asymmetry (worst), alarms, and the first keyframe whose prior raised one.
"""

from __future__ import annotations

import resource
import sys
from typing import Any

import numpy as np

from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.odometry import run_odometry
from bundle.synthetic.synthetic_flight import synthesize_flight

PERIOD = 0.25  # s per keyframe
BATCH = 1000


def main(keyframes: int, form: str, precision: str) -> None:
    flight = synthesize_flight(
        seed=1,
        duration=PERIOD * keyframes + 10.0,
        camera_rate=4.0,
        track_length=12.0,
        num_tracks=40,
    )
    records: list[KeyframeRecord] = []
    first: int | None = None

    def look(_done: int, _count: int, record: KeyframeRecord | None) -> bool:
        nonlocal first
        if record is None:
            return True
        records.append(record)
        if first is None and any("prior" in alarm for alarm in record.alarms):
            first = len(records)
        if len(records) % BATCH == 0:
            report(records[-BATCH:], len(records), first)
        return len(records) < keyframes

    result = run_odometry(
        flight.sequence,
        frame_rate=4.0,
        min_parallax=0.0,
        min_translation=0.0,
        imu_noise_scale=1.0,
        pixel_sigma=0.5,
        prior_form=form,
        precision=precision,
        progress=look,
    )
    print(f"{len(result.keyframes)} keyframes: {result.message}")


def report(records: list[KeyframeRecord], done: int, first: int | None) -> None:
    made = [r for r in records if r.prior_ratio is not None]

    def of(name: str) -> Any:
        return np.array([getattr(record, name) for record in made], float)

    total = 1e3 * np.median([record.times["total"] for record in records])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{done:6d}: {total:5.2f} ms, {np.mean([r.num_rows for r in records]):5.0f} rows, "
        f"{memory:5.0f} MB, ratio {np.median(of('prior_ratio')):.1e}, "
        f"definiteness {of('prior_definiteness').min():.0e}, "
        f"asymmetry {of('prior_asymmetry').max():.0e}, "
        f"{sum(bool(r.alarms) for r in records)} alarms, first {first}",
        flush=True,
    )


if __name__ == "__main__":
    words = sys.argv[1:]
    main(
        int(words[0]) if words else 10_000,
        words[1] if len(words) > 1 else "information",
        words[2] if len(words) > 2 else "double",
    )
