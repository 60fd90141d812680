"""Rigs refined through the public interface: reference costs, scale, warnings, files."""

import json
import pickle
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import InputError
from bundle.cli.main import main
from tests.printed import warning
from tests.rig_scenes import FIVE, STEREO, rig_problem

TIGHT = {"function_tolerance": 1e-14, "gradient_tolerance": 1e-12, "max_num_iterations": 500}
ALL_BUT_FOCAL = {"refine": ("poses", "points")}

# pycolmap 4.2.1 and GTSAM 4.3.0 on kitti26_stereo_rig. A metric rig loses six degrees under
# two_cameras here: COLMAP fixes seven, and ends at 2042.571817.
KITTI = {
    "sensors fixed, no gauge": (ALL_BUT_FOCAL | {"gauge": "none"}, 2042.4781621003897),
    "sensors fixed, two cameras": (ALL_BUT_FOCAL, 2042.4781621003897),
    "sensors refined": ({"refine": ("poses", "points", "sensor_from_rig")}, 1995.6747707716),
    "sensors refined, focal lengths": (
        {"refine": ("poses", "points", "focal", "sensor_from_rig")},
        1970.0580876,
    ),
    "sensors fixed, focal lengths": (
        {"refine": ("poses", "points", "focal"), "gauge": "none"},
        2013.9518866,
    ),
}


@pytest.fixture(scope="module")
def kitti(bundle_data: Path) -> bundle.Problem:
    return bundle.load(bundle_data / "rigs" / "kitti26_stereo_rig")


@pytest.mark.parametrize(
    ("case", "backend"),
    [
        *((case, "fused") for case in KITTI),
        *((case, "ceres") for case in ("sensors fixed, two cameras", "sensors refined")),
    ],
)
def test_reference_costs(kitti: bundle.Problem, backend: str, case: str) -> None:
    options, cost = KITTI[case]
    result = bundle.solve(kitti, backend=backend, **TIGHT, **options)
    assert result.summary.initial_cost == pytest.approx(17069.5531105, rel=1e-9)
    assert result.summary.final_cost == pytest.approx(cost, rel=1e-9)
    moved = (result.problem.sensor_from_rig != kitti.sensor_from_rig).any()
    assert moved == ("sensor_from_rig" in options["refine"])
    weak = "weak_baseline" in result.summary.warning_kinds
    assert weak == (case == "sensors refined, focal lengths")


def test_a_weak_baseline_is_told(kitti: bundle.Problem) -> None:
    result = bundle.solve(kitti, **TIGHT, **KITTI["sensors refined, focal lengths"][0])
    sentence = warning(result.summary, "weak_baseline")
    assert "721.538 -> 53" in sentence
    assert "0.5372 -> 0.74" in sentence


def test_a_metric_rig_returns_to_scale_twice(backend: str) -> None:
    problem = rig_problem(rigs=(STEREO, FIVE[:2]), num_alone=1, noise=0, perturbation=0)
    frames, poses = problem.rig_from_world.copy(), problem.cam_from_world.copy()
    for _ in range(2):
        frames[:, 4:] *= 1.3
        poses[:, 4:] *= 1.3
        start = problem.replace(
            rig_from_world=frames,
            points=problem.points * 1.3,
            cam_from_world=problem.replace(
                rig_from_world=frames, cam_from_world=None or _moved(problem, frames, poses)
            ).cam_from_world,
        )
        result = bundle.solve(start, backend=backend, refine=("poses", "points"), **TIGHT)
        assert result.summary.final_cost < 1e-12
        assert _size(result.problem) == pytest.approx(_size(problem), rel=1e-6)
        problem = result.problem
        frames, poses = problem.rig_from_world.copy(), problem.cam_from_world.copy()


def _moved(problem: bundle.Problem, frames: np.ndarray, poses: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    moved = problem.replace(rig_from_world=frames).cam_from_world.copy()
    alone = problem.image_frame < 0
    moved[alone] = poses[alone]
    return moved


def _size(problem: bundle.Problem) -> float:
    return float(np.linalg.norm(problem.points - problem.points.mean(axis=0)))


@pytest.mark.parametrize(
    "rigs, settings",
    [
        ((FIVE,), {}),
        ((STEREO, FIVE), {"num_alone": 2}),
        ((STEREO,), {"missing": {(0, 1, 0), (0, 2, 1)}}),
        ((STEREO,), {"first_ids": (3, 2**31 + 1, 2**32 - 60, 5)}),
    ],
    ids=["five", "several and alone", "frames with one image", "large ids"],
)
@pytest.mark.parametrize("refined", [False, True])
def test_shapes(tmp_path: Path, backend: str, rigs, settings, refined: bool) -> None:  # type: ignore[no-untyped-def]
    problem = rig_problem(rigs=rigs, **settings)
    result = bundle.solve(problem, backend=backend, refine_sensor_from_rig=refined)
    assert result.summary.final_cost < 0.5 * result.summary.initial_cost
    bundle.save(result.problem, tmp_path / "out")
    again = bundle.load(tmp_path / "out")
    np.testing.assert_allclose(again.cam_from_world, result.problem.cam_from_world, atol=1e-12)
    written = pycolmap.Reconstruction(tmp_path / "out")
    errors, _ = bundle.reprojection_errors(result.problem)
    assert written.compute_mean_reprojection_error() == pytest.approx(errors.mean(), rel=1e-3)


def test_a_held_camera_and_a_held_image() -> None:
    problem = rig_problem(rigs=(FIVE,))
    image = int(problem.image_ids[6])
    result = bundle.solve(problem, fixed_image_ids=[image], fixed_camera_ids=[2])
    frame = problem.image_frame[6]
    np.testing.assert_array_equal(
        result.problem.rig_from_world[frame], problem.rig_from_world[frame]
    )
    same = result.problem.image_frame == frame
    np.testing.assert_array_equal(result.problem.cam_from_world[same], problem.cam_from_world[same])
    np.testing.assert_array_equal(result.problem.camera_params[1], problem.camera_params[1])


def test_rounds_and_parts_keep_rigs() -> None:
    problem = rig_problem(rigs=(STEREO,), num_frames=6, num_alone=1)
    rounds = bundle.solve_rounds(problem, num_rounds=2, max_error=2.0, refine_sensor_from_rig=True)
    assert rounds.problem.num_frames == 6
    assert len(rounds.rounds) >= 1
    named = int(problem.image_ids[3])
    part = bundle.solve_rounds(problem, only_images=[named], refine_sensor_from_rig=True)
    moved = (part.problem.cam_from_world != problem.cam_from_world).any(axis=1)
    np.testing.assert_array_equal(moved, problem.image_frame == problem.image_frame[3])
    np.testing.assert_array_equal(part.problem.sensor_from_rig, problem.sensor_from_rig)


def test_a_part_refines_the_sensors_of_which_it_has_all_images() -> None:
    """All images at once are the plain solve, with the sensors on their rigs."""
    problem = rig_problem(rigs=(STEREO, FIVE[:2]), num_frames=6)
    settings = TIGHT | {"refine_sensor_from_rig": True, "gauge": "none"}
    whole = bundle.solve(problem, **settings)
    for rest in ("fixed", "marginal"):
        every = bundle.solve_rounds(
            problem, only_images=problem.image_ids.tolist(), rest=rest, **settings
        )
        assert every.part.num_sensors == problem.num_sensors
        assert every.summary.final_cost == pytest.approx(whole.summary.final_cost, rel=1e-9)
        assert (every.problem.sensor_from_rig != problem.sensor_from_rig).any(axis=1).all()
    # one rig alone: its sensors move, those of the other rig do not; nor does a fixed one
    first = problem.frame_rig_ids[problem.image_frame] == problem.frame_rig_ids[0]
    own = problem.sensor_rig_ids == problem.frame_rig_ids[0]
    named = problem.image_ids[first].tolist()
    half = bundle.solve_rounds(problem, only_images=named, **settings)
    moved = (half.problem.sensor_from_rig != problem.sensor_from_rig).any(axis=1)
    np.testing.assert_array_equal(moved, own)
    assert half.part.num_sensors == own.sum()
    keys = zip(
        problem.sensor_rig_ids[own].tolist(), problem.sensor_camera_ids[own].tolist(), strict=True
    )
    held = bundle.solve_rounds(problem, only_images=named, fixed_sensors=tuple(keys), **settings)
    np.testing.assert_array_equal(held.problem.sensor_from_rig, problem.sensor_from_rig)
    # a part of the frames would move images that are not named
    few = bundle.solve_rounds(problem, only_images=named[:2], **settings)
    assert few.part.num_sensors == 0
    np.testing.assert_array_equal(few.problem.sensor_from_rig, problem.sensor_from_rig)


@pytest.mark.parametrize(("images", "words"), [("*", "sensors on rigs"), ("0*", "no sensors")])
def test_a_report_says_which_sensors_a_part_refines(
    images: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = rig_problem(rigs=(STEREO,), num_frames=4)
    bundle.save(problem, tmp_path / "rig")
    named = images if images == "*" else str(problem.image_ids[0])
    flags = ["--only-images", named, "--refine-sensor-from-rig", "--verbose", "--quiet"]
    assert main(["refine", str(tmp_path / "rig"), "-o", str(tmp_path / "out"), *flags]) == 0
    assert words in " ".join(capsys.readouterr().out.split())
    moved = bundle.load(tmp_path / "out").sensor_from_rig != problem.sensor_from_rig
    assert moved.any() == (images == "*")


def test_the_gauge_freedom_of_a_result_counts_priors_and_factors() -> None:
    problem = rig_problem(rigs=(STEREO,), num_frames=5)
    places = [
        bundle.PositionPrior(int(key), center, sigma=0.01)
        for key, center in zip(problem.image_ids, problem.projection_centers, strict=True)
    ]
    free, held = bundle.solve(problem), bundle.solve(problem, priors=places)
    assert (free.gauge_freedom.degrees, held.gauge_freedom.degrees) == (6, 0)
    pose = bundle.PriorFactor(
        ("frame", int(problem.frame_ids[0])), problem.rig_from_world[0], np.eye(6)
    )
    tied = bundle.solve(problem, factors=[pose])
    assert tied.gauge_freedom.degrees == 0
    assert pickle.loads(pickle.dumps(tied)).gauge_freedom.degrees == 0


def test_a_checkpoint_keeps_rigs(tmp_path: Path) -> None:
    problem = rig_problem(rigs=(STEREO,))
    settings = {"num_rounds": 2, "max_error": 3.0, "refine_sensor_from_rig": True}
    once = bundle.solve_rounds(problem, checkpoint=tmp_path / "c.npz", **settings)
    again = bundle.solve_rounds(problem, resume=tmp_path / "c.npz", **settings)
    for name in ("rig_from_world", "sensor_from_rig", "cam_from_world"):
        np.testing.assert_array_equal(getattr(again.problem, name), getattr(once.problem, name))


def test_sensors_are_named_on_either_way() -> None:
    one = bundle.SolveOptions(refine="poses,points,sensor-from-rig")
    other = bundle.SolveOptions(refine=("poses", "points"), refine_sensor_from_rig=True)
    assert one == other
    with pytest.raises(InputError, match=r"sensor_from_rig"):
        bundle.SolveOptions(refine="sensors")


def test_refine_on_the_command_line(tmp_path: Path) -> None:
    from bundle.cli.main import main

    bundle.save(rig_problem(rigs=(STEREO, FIVE)), tmp_path / "in")
    arguments = ["refine", tmp_path / "in", "-o", tmp_path / "out", "--json", tmp_path / "r.json"]
    more = ["--refine", "poses,points,sensor-from-rig", "--fix-sensors", "1:2", "--quiet"]
    assert main([*map(str, arguments), *more]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert (report["input"]["num_rigs"], report["input"]["num_sensors"]) == (2, 5)
    assert sorted(s["camera_id"] for s in report["sensors"]) == [4, 5, 6, 7]
    assert (
        main(["refine", str(tmp_path / "in"), "-o", str(tmp_path / "x"), "--fix-sensors", "9:9"])
        == 2
    )
