"""Records of keyframes: their alarms by kind."""

from __future__ import annotations

from dataclasses import replace

from bundle.inertial.vio.keyframe_record import alarms_by_kind
from bundle.inertial.vio.odometry import run_odometry
from bundle.synthetic.synthetic_flight import synthesize_flight


def test_alarms_that_differ_in_their_numbers_are_one_kind() -> None:
    flight = synthesize_flight(duration=3.0, rest=1.5, num_tracks=20, seed=2)
    records = run_odometry(flight.sequence, time_budget=10.0).keyframes[:3]
    one, other = "prior asymmetric: by 1e-05", "prior asymmetric: by 2e-05"
    alarms = [(one, "no excitation: a"), (), (other,)]
    given = [replace(record, alarms=of) for record, of in zip(records, alarms, strict=True)]
    first, _, last = (record.timestamp_ns for record in given)
    assert alarms_by_kind(given) == {
        "prior asymmetric": [
            (first, one),
            (last, other),
        ],
        "no excitation": [(first, "no excitation: a")],
    }
