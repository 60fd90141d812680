"""Findings about an adjustment with an IMU: both sides of each bound, and none by default."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.inertial.offline.imu_agreement import Agreement, ClockErrors, ClockOffset
from bundle.inertial.offline.imu_findings import Evidence, imu_findings
from bundle.inertial.offline.rotation_map import RotationMap
from bundle.inertial.offline.score_tests import Score
from bundle.model.sequence.sequence_findings import BadStretch

ARM = np.array([0, 0, 0, 1, 0.1, 0, 0])
MAP = RotationMap(np.eye(3), np.full(3, 1e-3), 1e-3, 1.0)
QUIET = np.full(50, 5.0)
STAMPS = 5_000_000 * np.arange(2500)  # 12.5 s at 200 Hz


def known(intervals=QUIET, chi2=100.0, **changes):
    agreement = Agreement(chi2, 300, np.asarray(intervals), 1.0)
    return Evidence(
        **{
            "agreement": agreement,
            "is_converged": True,
            "is_quadratic": False,
            "rotations": MAP,
            "far": ("accel_axes", ""),
            "held": lambda: None,
            "clocks": ClockErrors(),
            "offset": ClockOffset(),
            "noise": (0.3, 0.3),
            "quietest": 1.0,
            "noise_scale": 5.0,
            "camera_from_imu": ARM,
            "bad": (),
            "stamps": STAMPS,
            "place": lambda row: f"line {row + 2}",
            "begins": 10_000_000 + 200_000_000 * np.arange(50),
            **changes,
        }
    )


def kinds(**changes):
    return [one.kind for one in imu_findings(known(**changes))]


def turned(degrees):
    return MAP._replace(matrix=Rotation.from_rotvec(np.radians([degrees, 0, 0])).as_matrix())


def fault(first=600, last=700, kind="frozen"):
    return BadStretch(kind, "gyro", first, last)


def test_an_adjustment_that_agrees_has_no_findings():
    assert kinds() == []


def test_a_contradiction_names_its_time():
    intervals = QUIET.copy()
    intervals[17] = 30.0
    (found,) = imu_findings(known(intervals, 2400.0))
    assert (found.kind, found.is_problem) == ("imu_contradiction", True)
    evidence = dict(found.evidence)
    assert evidence.pop("bound") == pytest.approx(380, rel=0.02)
    assert evidence == {
        "cause": "unknown", "chi2": 2400.0, "freedom": 300, "seconds": pytest.approx(3.41),
        "row": 682,
    }  # fmt: skip
    assert "8 times" in found.sentence and "3.41 s (line 684)" in found.sentence
    assert found.flags == ("--imu-noise-scale", "14")  # 5 sqrt(8)


@pytest.mark.parametrize(
    ("changes", "cause"),
    [
        ({"rotations": MAP._replace(matrix=-np.eye(3))}, "gyro_axes"),
        ({"far": ("accel_axes", "the accelerometer is reversed")}, "accel_axes"),
        ({"far": ("imu_clocks", "the clocks differ by 2 s")}, "imu_clocks"),
        ({"camera_from_imu": np.array([0, 0, 0, 1, 3.1, 0, 0])}, "arm"),
        ({"camera_from_imu": np.array([0, 0, 0, 1, 2.9, 0, 0])}, "unknown"),
        ({"bad": (fault(),)}, "imu_samples"),
        ({"rotations": turned(5)}, "camera_from_imu"),
        ({"rotations": MAP._replace(matrix=1.03 * np.eye(3))}, "gyro_scale"),
        ({"clocks": ClockErrors(5e-3, 0.6)}, "imu_clocks"),
        ({"offset": ClockOffset(0.02, 1e-3)}, "unknown"),
        ({"noise": (6.0, 0.3)}, "imu_noise"),
        ({"noise": (0.3, 0.19)}, "imu_noise"),
        ({"noise": (0.21, 0.21)}, "unknown"),
        ({"noise": (0.0, 0.0)}, "unknown"),
    ],
)
def test_a_contradiction_has_the_cause_that_other_evidence_shows(changes, cause):
    found = imu_findings(known(chi2=2400.0, **changes))[0]
    assert found.evidence["cause"] == cause
    assert found.is_problem


def test_outliers_under_a_quadratic_loss_are_the_cause():
    for variance, is_quadratic, cause in (
        (4.1, True, "outliers"), (3.9, True, "unknown"), (4.1, False, "unknown"),
    ):  # fmt: skip
        found = known(is_quadratic=is_quadratic)
        agreement = Agreement(2400.0, 300, QUIET, 1.0, variance)
        first = imu_findings(found._replace(agreement=agreement))[0]
        assert first.evidence["cause"] == cause
        assert (first.flags == ("--loss", "cauchy")) == (cause == "outliers")


def wrong(kind, x, sigma, along=(1.0,), **more):
    return lambda: Score(kind, np.array(along), x, sigma, movement=0.047, **more)


def test_a_value_that_is_held_wrongly_if_nothing_else_is_wrong():
    arm = wrong("arm", -0.1, 0.01, (0.0, 1.0, 0.0), gain=1210.0)
    (found,) = imu_findings(known(held=arm))
    assert (found.kind, found.is_problem, found.flags) == ("arm", False, ())
    assert found.evidence["translation"] == pytest.approx([0.1, -0.1, 0])
    assert (found.evidence["metres"], found.evidence["metres_sigma"]) == pytest.approx((0.1, 0.01))
    assert "10 +- 1 cm" in found.sentence and "0.100, -0.100, 0.000" in found.sentence
    first, second = imu_findings(known(chi2=2400.0, held=arm))
    assert (first.evidence["cause"], second.kind) == ("arm", "arm")
    (found,) = imu_findings(known(held=wrong("accel_scale", 0.1, 0.02)))
    assert found.evidence == {"ratio": 1.1, "ratio_sigma": 0.02, "movement": 0.047}
    assert "1.100 +- 0.02 times" in found.sentence and "by 4.7 %" in found.sentence
    (found,) = imu_findings(known(held=wrong("gyro_scale", 0.015, 0.001)))
    assert (found.kind, found.evidence["ratio"]) == ("gyro_scale", pytest.approx(1.015))
    turn = wrong("camera_from_imu", 0.02, 0.001, (0.0, 0.0, 1.0))
    (found,) = imu_findings(known(held=turn))
    assert found.evidence["degrees"] == pytest.approx(np.degrees(0.02))
    assert found.evidence["quaternion"] == pytest.approx([0, 0, np.sin(0.01), np.cos(0.01)])


@pytest.mark.parametrize(
    ("kind", "words"), [("gyro_bias", "gyroscope"), ("accel_bias", "accelerometer")]
)
def test_a_bias_that_changes_names_its_size_and_time(kind, words):
    step = wrong(kind, -0.5, 0.02, (0.0, 1.0, 0.0), interval=17)
    (found,) = imu_findings(known(held=step))
    assert (found.kind, found.is_problem) == (kind, False)
    evidence = dict(found.evidence)
    assert evidence.pop("step") == pytest.approx([0, -0.5, 0])
    assert evidence == {
        "step_sigma": 0.02, "seconds": pytest.approx(3.41), "row": 682, "movement": 0.047,
    }  # fmt: skip
    for part in (words, "0.5 +- 0.02 ", "3.41 s (line 684)", "by 4.7 %", f"{kind}_random_walk of"):
        assert part in found.sentence
    assert f"of {0.5 / 9.8**0.5:.1g} " in found.sentence  # the video has 9.8 s


def test_values_that_are_held_are_tested_unless_a_cause_is_known():
    assert kinds(held=pytest.fail, noise=(6.0, 0.3)) == ["imu_noise"]
    step = wrong("accel_bias", 0.5, 0.02, (1.0, 0.0, 0.0), gain=1210.0)
    intervals = QUIET.copy()
    intervals[17] = 60.0
    assert kinds(intervals=intervals, held=step) == ["accel_bias", "imu_interval"]
    assert kinds(offset=ClockOffset(0.02, 1e-3), held=step) == ["accel_bias", "imu_clocks"]


def test_a_held_value_that_explains_less_than_half_of_a_contradiction_is_not_its_cause():
    for gain, cause in ((1190.0, "unknown"), (1210.0, "accel_bias")):
        step = wrong("accel_bias", 0.5, 0.02, (1.0, 0.0, 0.0), gain=gain)
        assert imu_findings(known(chi2=2400.0, held=step))[0].evidence["cause"] == cause


def test_the_next_command_of_a_contradiction():
    def flags(**changes):
        return imu_findings(known(chi2=2400.0, **changes))[0].flags

    assert flags(is_converged=False) == ("--max-iterations", "200")
    few = imu_findings(known(chi2=2400.0, is_converged=False, noise=(0.01, 1.0)))[0]
    assert few.evidence["cause"] == "not_converged"
    assert flags(rotations=turned(5), is_converged=False) == ()
    assert flags(noise=(0.01, 1.0)) == ("--imu-noise-scale", "1e+02")


def test_samples_that_are_no_measurements():
    bad = (fault(), fault(900, 900, "spike"), fault(1000, 1009))
    (found,) = imu_findings(known(bad=bad))
    assert (found.kind, found.is_problem) == ("imu_samples", False)
    assert found.evidence["faults"] == [
        {
            "kind": "frozen", "sensor": "gyro", "first_row": 600, "last_row": 1009,
            "num_samples": 111, "seconds": 3.0,
        },
        {
            "kind": "spike", "sensor": "gyro", "first_row": 900, "last_row": 900,
            "num_samples": 1, "seconds": 4.5,
        },
    ]  # fmt: skip
    assert "line 602: gyroscope frozen, 111 samples from 3.00 to 5.04 s" in found.sentence
    assert "line 902: gyroscope spike, 1 sample at 4.50 s" in found.sentence


@pytest.mark.parametrize(("lost", "is_named"), [(24, False), (26, True)])
def test_lost_samples_from_a_hundredth_on(lost, is_named):
    gone = np.concatenate([400 + np.arange(lost // 2), 1200 + np.arange(lost // 2)])
    stamps = np.delete(5_000_000 * np.arange(2524), gone)  # 2,500 or 2,498 are left
    assert kinds(stamps=stamps) == is_named * ["imu_samples"]
    single = np.delete(5_000_000 * np.arange(2500), np.arange(10, 2000, 2))
    assert kinds(stamps=single[:990]) == []  # half the rate
    if is_named:
        (found,) = imu_findings(known(stamps=stamps, bad=(fault(),)))
        assert found.evidence["faults"][1] == {
            "kind": "lost", "sensor": "both", "first_row": 399, "last_row": 1187,
            "num_samples": 26, "seconds": pytest.approx(1.995),
        }  # fmt: skip
        assert "line 402: 26 samples lost from 2.00 to 6.07 s; line 602: gyro" in found.sentence


def test_a_turned_camera_from_imu_with_the_right_one():
    assert kinds(rotations=turned(0.9)) == []
    arm = Rotation.from_rotvec([0.2, 0.3, -0.4])
    given = np.array([*arm.as_quat(), 0, 0, 0])
    (found,) = imu_findings(known(rotations=turned(4.0), camera_from_imu=given))
    assert found.kind == "camera_from_imu"
    assert found.evidence["degrees"] == pytest.approx(4.0)
    right = arm * Rotation.from_matrix(turned(4.0).matrix)
    assert (right.inv() * Rotation.from_quat(found.evidence["quaternion"])).magnitude() < 1e-9


def test_scale_of_rates():
    for scale, expected in ((1.019, []), (1.021, ["gyro_scale"]), (0.97, ["gyro_scale"])):
        assert kinds(rotations=MAP._replace(matrix=scale * np.eye(3))) == expected
    short = MAP._replace(matrix=np.eye(3) / 1.03)
    assert kinds(rotations=short, bad=(fault(kind="saturated"),)) == ["imu_samples"]
    (found,) = imu_findings(known(rotations=short))
    assert found.evidence["ratio"] == pytest.approx(1.03)


def test_clocks():
    both = [
        (ClockErrors(1.6e-3, 0.51), 1), (ClockErrors(1.4e-3, 0.51), 0),
        (ClockErrors(1.6e-3, 0.49), 0),
        (ClockErrors(0, 0, 4.2e-4, 1e-5), 1), (ClockErrors(0, 0, 4.0e-4, 1e-5), 0),
        (ClockErrors(0, 0, -5e-3, 0.9e-3), 1), (ClockErrors(0, 0, -5e-3, 1.1e-3), 0),
    ]  # fmt: skip
    for clocks, count in both:  # the video has 9.8 s
        assert kinds(clocks=clocks) == count * ["imu_clocks"]
    (found,) = imu_findings(known(offset=ClockOffset(0.02, 1e-3)))
    assert found.evidence == {"offset": 0.02, "offset_sigma": 1e-3}


def test_calibrated_noise_above_that_of_the_samples():
    assert kinds(noise=(4.9, 4.9)) == []
    (found,) = imu_findings(known(noise=(5.1, 7.0)))
    assert (found.kind, found.evidence) == ("imu_noise", {"sensor": "accelerometer", "ratio": 7.0})


def test_calibrated_noise_far_below_that_of_the_quietest_samples():
    for scale in (1.0, 5.0):  # a factor for vibration is part of the assumed noise
        assert kinds(quietest=9.9 * scale, noise_scale=scale) == []
        (found,) = imu_findings(known(quietest=10.1 * scale, noise_scale=scale))
        assert found.kind == "imu_noise"
        assert found.evidence["ratio"] == pytest.approx(1 / (10.1 * scale))
    assert found.flags == ("--imu-noise-scale", "50")
    assert kinds(quietest=float("nan")) == []


def test_wrong_intervals_by_row_and_time():
    intervals = QUIET.copy()
    intervals[[4, 30]] = 50.0, 60.0
    (found,) = imu_findings(known(intervals))
    assert (found.kind, found.is_problem) == ("imu_interval", False)
    assert found.evidence["intervals"] == [30, 4]
    assert found.evidence["chi2"] == [60.0, 50.0]
    assert found.evidence["rows"] == [1202, 162]
    assert found.evidence["seconds"] == pytest.approx([6.01, 0.81])
