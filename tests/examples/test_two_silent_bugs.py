"""The example of two silent bugs shows both, and their cures."""

from __future__ import annotations

import importlib.util
from pathlib import Path

PLACE = Path(__file__).parents[2] / "examples" / "two_silent_bugs" / "two_silent_bugs.py"
spec = importlib.util.spec_from_file_location("two_silent_bugs", PLACE)
assert spec is not None and spec.loader is not None
example = importlib.util.module_from_spec(spec)
spec.loader.exec_module(example)


def test_a_newer_estimate_makes_yaw_known() -> None:
    assert example.first_bug() == {"first estimates": 3, "newer estimate of the landmark": 2}


def test_single_precision_loses_the_sign_and_a_square_root_keeps_it() -> None:
    found = example.second_bug(6.0)
    indefinite, alarms = found["information, single precision"]
    assert indefinite < -1e-9
    assert alarms > 0
    for name, (least, count) in found.items():
        if name != "information, single precision":
            assert least > -1e-11, name
            assert count == 0, name


def test_it_is_short() -> None:
    code = [line for line in PLACE.read_text().splitlines() if line.strip()]
    assert len(code) < 90
