"""IMU with rounds, control points and attitudes; frames of a rig that carry the IMU."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.georeference.control_point import Measurement
from bundle.georeference.similarity import Similarity, moved
from bundle.inertial.offline.inertial_start import to_priors
from bundle.inertial.offline.motion_solve import ImuBodies
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.interface.judging_options import HoldOutOptions
from bundle.interface.round_options import RoundOptions
from bundle.solving.rounds.plan import RunPlan
from tests.inertial.offline.models import model_of
from tests.inertial.offline.test_imu_adjustment import adjusted, error_of
from tests.inertial.offline.test_imu_consistency import true_poses

OPTIONS = bundle.SolveOptions(refine=("poses", "points"), max_num_iterations=100)
SETTINGS = {"imu_noise_scale": 1.0, "imu_samples": "interval"}


@pytest.fixture(scope="module")
def flight():
    return bundle.synthesize_flight(duration=6.0, num_tracks=80, seed=1)


@pytest.fixture(scope="module")
def model(flight):
    """A model at the minimum of its images, with good observations only, and its times."""
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 6)
    alone = bundle.solve_rounds(problem, OPTIONS, num_rounds=3, max_error=6.0)
    return alone.problem, stamps


def with_outliers(problem, seed):
    """Return the problem with 3 % of its observations 20 to 60 pixels off, and their mask."""
    rng = np.random.default_rng(seed)
    planted = rng.random(problem.num_observations) < 0.03
    shift = rng.uniform(20, 60, (problem.num_observations, 2)) * rng.choice(
        [-1, 1], (problem.num_observations, 2)
    )
    moved_xy = problem.observation_xy + planted[:, None] * shift
    return problem.replace(observation_xy=moved_xy), planted


@pytest.mark.parametrize("seed", range(3))
def test_rounds_remove_planted_outliers_and_end_at_the_clean_minimum(flight, model, seed):
    problem, stamps = model
    wrong, planted = with_outliers(problem, seed)
    plan = RunPlan(rounds=RoundOptions(num_rounds=5, max_error=8.0))
    options = OPTIONS.replace(loss="cauchy", loss_scale=2.0, function_tolerance=1e-10)
    found = adjusted(flight.sequence, wrong, stamps, options, plan=plan, **SETTINGS)
    mask = found.result.observation_mask
    assert not mask[planted].any()
    # a planted one may take a right one of its short track along
    assert (~mask).sum() < 3 * planted.sum()
    left = problem.select(observations=mask).problem
    clean = adjusted(flight.sequence, left, stamps, options, **SETTINGS)
    error = found.result.problem.projection_centers - clean.result.problem.projection_centers
    error -= error.mean(axis=0)
    assert np.abs(error).max() < 1e-3
    cost = clean.result.summary.final_cost
    assert found.result.summary.final_cost == pytest.approx(cost, rel=1e-5)
    first = found.result.rounds[0]
    assert (first.num_points, first.num_observations) == (
        problem.num_points, problem.num_observations,
    )  # fmt: skip
    assert len(found.velocities) == len(stamps)
    assert found.gauge_freedom == 4


@pytest.mark.parametrize("seed", (1, 2))
def test_rounds_find_the_offset_of_the_clocks_beside_outliers(flight, seed):
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 4)
    alone = bundle.solve_rounds(problem, OPTIONS, num_rounds=3, max_error=6.0)
    inner = stamps < stamps[-1]  # 20 ms later it has no samples
    problem, stamps = alone.problem.select(images=inner).problem, stamps[inner]
    wrong, _ = with_outliers(problem, seed)
    plan = RunPlan(rounds=RoundOptions(num_rounds=5, max_error=8.0))
    found = adjusted(flight.sequence, wrong, stamps + 20_000_000, OPTIONS, plan=plan, **SETTINGS)
    assert found.clock.seconds == pytest.approx(-0.02, abs=4 * found.clock.sigma)
    assert found.clock.sigma < 6e-3
    assert found.result.summary.is_solution_usable
    assert [one.kind for one in found.findings] == ["imu_clocks"]


def test_rounds_without_anything_to_remove_change_nothing(flight, model):
    problem, stamps = model
    plan = RunPlan(rounds=RoundOptions(num_rounds=3, max_error=500.0, min_angle=0.0))
    found = adjusted(flight.sequence, problem, stamps, OPTIONS, plan=plan, **SETTINGS)
    alone = adjusted(flight.sequence, problem, stamps, OPTIONS, **SETTINGS)
    assert len(found.result.rounds) == 1
    assert found.result.observation_mask is None
    cost = alone.result.summary.final_cost
    assert found.result.summary.final_cost == pytest.approx(cost, rel=1e-5)


def control_points(flight, problem, stamps, count, sigma, yaw):
    """Surveyed points that the true cameras see, in a world turned about z."""
    rng = np.random.default_rng(8)
    rotation, shift = true_poses(flight, stamps)
    centers = -rotation.inv().apply(shift)
    focal, _, *center = problem.camera_params[0, :4]
    turn, points = Rotation.from_euler("z", yaw), []
    for k in range(count):
        one = k * (len(stamps) - 1) // count
        ahead = rotation[one].inv().apply([*rng.uniform(-0.3, 0.3, 2), 1.0])
        place, seen = centers[one] + 4 * ahead, []
        for image in range(len(stamps)):
            x, y, z = rotation[image].apply(place) + shift[image]
            pixel = focal * np.array([x, y]) / z + center if z > 0.5 else np.full(2, -1.0)
            if ((pixel > 0) & (pixel < (752, 480))).all():
                seen.append(Measurement(problem.image_names[image], *pixel))
        points.append(
            bundle.GroundControlPoint(
                name=f"t{k}",
                position=tuple(turn.apply(place)),
                measurements=tuple(seen),
                sigma=sigma,
            )
        )
    return points, turn


def test_control_points_give_place_and_heading(flight, model):
    problem, stamps = model
    points, turn = control_points(flight, problem, stamps, 4, (0.01, 0.01), 0.9)
    plan = RunPlan(rounds=RoundOptions(num_rounds=2, max_error=8.0))
    found = adjusted(
        flight.sequence, problem, stamps, OPTIONS, priors=points, plan=plan, **SETTINGS
    )
    rotation, shift = true_poses(flight, stamps)
    expected = turn.apply(-rotation.inv().apply(shift))
    assert np.abs(found.result.problem.projection_centers - expected).max() < 0.1
    assert [one.name for one in found.result.control_points] == ["t0", "t1", "t2", "t3"]
    assert max(np.abs(one.residual).max() for one in found.result.control_points) < 0.1
    assert found.result.problem.num_points <= problem.num_points
    assert found.gauge_freedom == 0


@pytest.mark.parametrize(("kind", "free"), [("gravity", 4), ("orientation", 3), ("heading", 3)])
def test_attitudes_beside_the_motions(flight, model, kind, free):
    problem, stamps = model
    rotation, _ = true_poses(flight, stamps)
    turned = rotation * Rotation.from_euler("z", 2.5).inv()
    down, ahead = turned.apply([0, 0, -1.0]), turned.inv().apply([0, 0, 1.0])
    ids = problem.image_ids.tolist()
    priors = {
        "gravity": [bundle.GravityPrior(i, d, 0.5) for i, d in zip(ids, down, strict=True)],
        "orientation": [
            bundle.OrientationPrior(i, q, 0.5) for i, q in zip(ids, turned.as_quat(), strict=True)
        ],
        "heading": [
            bundle.HeadingPrior(i, np.degrees(np.arctan2(a[0], a[1])), 0.5)
            for i, a in zip(ids, ahead, strict=True)
        ],
    }
    given = priors[kind]
    found = adjusted(flight.sequence, problem, stamps, OPTIONS, priors=given, **SETTINGS)
    assert found.gauge_freedom == free
    poses = Rotation.from_quat(found.result.problem.cam_from_world[:, :4])
    tilts = poses.apply([0, 0, -1.0]) - down
    assert np.abs(tilts).max() < 0.02
    if kind != "gravity":
        assert (poses.inv() * turned).magnitude().max() < 0.02


def test_the_minimum_with_attitudes_is_that_of_a_dense_system(monkeypatch, flight, model):
    """The Newton step of all factors, from the information matrix of a graph, is zero."""
    from bundle.inertial.offline import motion_solve
    from bundle.solving.request import place_at_priors
    from tests.inertial.offline.test_imu_consistency import graph_of

    problem, stamps = model
    keep = problem.observation_point < 12
    problem = problem.select(observations=keep, points=np.arange(problem.num_points) < 12).problem
    rotation, _ = true_poses(flight, stamps)
    ids = problem.image_ids.tolist()
    priors = tuple(
        bundle.OrientationPrior(i, q, 0.5) for i, q in zip(ids, rotation.as_quat(), strict=True)
    )
    solves = []

    def run(request, *others):
        result = original(request, *others)
        solves.append((result.problem, request.factors))
        return result

    original = motion_solve.run
    monkeypatch.setattr(motion_solve, "run", run)
    options = OPTIONS.replace(function_tolerance=1e-16, parameter_tolerance=1e-14)
    found = adjusted(flight.sequence, problem, stamps, options, priors=priors, **SETTINGS)
    end, factors = solves[found.num_solves - 1]
    placed = place_at_priors(end, tuple(factors), priors, align=False)
    graph = graph_of(placed.problem, placed.factors)
    keys = [key for key in graph.values if key != "lens"]
    information, eta = graph.information(keys)
    values, vectors = np.linalg.eigh(information)
    seen = values > 1e-9 * values.max()
    step = vectors[:, seen] @ ((vectors[:, seen].T @ eta) / values[seen])
    decrease = 0.5 * step @ information @ step
    assert decrease < 1e-7 * found.result.summary.final_cost
    assert graph.cost() == pytest.approx(found.result.summary.final_cost, rel=1e-9)


RIG_ARM = np.array([*Rotation.from_rotvec([0.02, -0.05, 0.01]).as_quat(), -0.2, 0.01, 0.03])


def stereo_of(flight, step, *, scale=1.0, seed=0, noise=0.5):
    """A rig of two cameras on the flight, at frames of its times, in a world of its own."""
    rng = np.random.default_rng(seed)
    _, stamps = model_of(flight.sequence, flight.ground_truth, step)
    rotation, shift = true_poses(flight, stamps)
    centers = -rotation.inv().apply(shift)
    params = np.array([400.0, 400.0, 376.0, 240.0])
    points = rng.uniform(centers.min(axis=0) - 4, centers.max(axis=0) + 4, (150, 3))
    arm, count = Rotation.from_quat(RIG_ARM[:4]), len(stamps)
    images, seen, pixels = [], [], []
    for frame in range(count):
        first = rotation[frame].apply(points) + shift[frame]
        for sensor, place in enumerate((first, arm.apply(first) + RIG_ARM[4:])):
            xy = params[:2] * place[:, :2] / np.where(place[:, 2:] > 0.3, place[:, 2:], np.nan)
            xy += params[2:]
            rows = np.flatnonzero(((xy > 0) & (xy < (752, 480))).all(axis=1))
            images += [2 * frame + sensor] * len(rows)
            seen += rows.tolist()
            pixels.append(xy[rows] + noise * rng.normal(size=(len(rows), 2)))
    kept = np.bincount(seen, minlength=len(points)) > 3
    used = kept[seen]
    start = Rotation.from_rotvec(0.01 * rng.normal(size=(count, 3))) * rotation
    places = start.apply(-(centers + 0.02 * rng.normal(size=centers.shape)))
    poses = np.hstack([start.as_quat(), places])
    on_arm = np.hstack([(arm * start).as_quat(), arm.apply(places) + RIG_ARM[4:]])
    problem = bundle.Problem(
        cam_from_world=np.stack([poses, on_arm], axis=1).reshape(-1, 7),
        image_ids=np.arange(1, 2 * count + 1),
        image_names=[f"cam{k % 2}/{stamps[k // 2]}.png" for k in range(2 * count)],
        image_camera=np.tile([0, 1], count),
        camera_ids=np.array([1, 2]),
        camera_models=["PINHOLE"] * 2,
        camera_params=np.tile(params, (2, 1)),
        camera_sizes=np.array([[752, 480]] * 2),
        points=points[kept] + 0.02 * rng.normal(size=(int(kept.sum()), 3)),
        point_ids=np.arange(1, kept.sum() + 1),
        observation_image=np.array(images)[used],
        observation_point=(np.cumsum(kept) - 1)[np.array(seen)[used]],
        observation_xy=np.concatenate(pixels)[used],
        rig_from_world=poses,
        frame_ids=np.arange(1, count + 1),
        image_frame=np.repeat(np.arange(count), 2),
        image_sensor=np.tile([-1, 0], count),
        sensor_from_rig=RIG_ARM[None],
        sensor_rig_ids=np.array([1]),
        sensor_camera_ids=np.array([2]),
    )
    turn = Rotation.random(random_state=4).as_matrix()
    return moved(problem, Similarity(1 / scale, turn, np.array([2.0, -1, 5]))), stamps


def test_frames_of_a_rig_carry_the_imu(flight):
    problem, stamps = stereo_of(flight, 8)
    found = adjusted(flight.sequence, problem, np.repeat(stamps, 2), OPTIONS, **SETTINGS)
    refined = found.result.problem
    np.testing.assert_array_equal(refined.sensor_from_rig, problem.sensor_from_rig)
    images = refined.select(images=refined.image_sensor < 0).problem.without_rigs()
    error = error_of(None, images, stamps, flight.sequence, flight.ground_truth)
    assert error.ate_yaw < 0.01
    assert error.rotation_rms < 0.3
    assert found.timestamps_ns.tolist() == stamps.tolist()
    assert found.velocities.shape == (len(stamps), 3)
    truth = states_at(flight.ground_truth, stamps)[:, 7:10]
    speeds = np.linalg.norm(truth, axis=1)
    np.testing.assert_allclose(np.linalg.norm(found.velocities, axis=1), speeds, atol=0.1)
    assert found.gauge_freedom == 4


def test_a_rig_of_unknown_scale_needs_refined_sensors(flight):
    problem, stamps = stereo_of(flight, 8, scale=3.7)
    times = np.repeat(stamps, 2)
    with pytest.raises(InputError, match="sensor-from-rig"):
        adjusted(flight.sequence, problem, times, OPTIONS, **SETTINGS)
    options = OPTIONS.replace(refine_sensor_from_rig=True)
    found = adjusted(flight.sequence, problem, times, options, **SETTINGS)
    arm = found.result.problem.sensor_from_rig[0, 4:]
    assert np.linalg.norm(arm) == pytest.approx(np.linalg.norm(RIG_ARM[4:]), rel=0.1)


def test_rigs_that_cannot_carry_an_imu_are_refused(flight):
    problem, stamps = stereo_of(flight, 8)
    times = np.repeat(stamps, 2)
    late = times.copy()
    late[3] += 1
    frames = problem.image_frame.copy()
    frames[:2] = -1
    sensors = problem.image_sensor.copy()
    cases = (
        (problem, late, "one time"),
        (problem.replace(image_frame=frames, image_sensor=np.where(frames < 0, -1, sensors)),
         times, "2 images without"),
        (problem.select(images=sensors >= 0).problem, times[1::2], "reference sensor"),
    )  # fmt: skip
    for given, when, word in cases:
        with pytest.raises(InputError, match=word) as error:
            ImuBodies.of(given, when, flight.sequence.calibration.camera_from_imu)
        assert "\n" not in str(error.value) and json.dumps(str(error.value))


def test_one_position_gives_no_heading(model):
    problem, _ = model
    names = problem.image_names
    one = bundle.PositionPrior(names[0], (0.0, 0.0, 0.0), 1.0)
    flat = bundle.PositionPrior(names[-1], (5.0, 0.0, float("nan")), 1.0)
    for priors in ([one], [one, flat]):
        with pytest.raises(InputError, match="found 1"):
            to_priors(problem, priors)


@pytest.mark.parametrize(
    "more", [{"checkpoint": "c.npz"}, {"resume": "c.npz"}, {"held_out": HoldOutOptions(hold_out=5)}]
)
def test_a_plan_has_rounds_only(flight, model, more):
    problem, stamps = model
    with pytest.raises(InputError, match=r"^plan: "):
        adjusted(flight.sequence, problem, stamps, plan=RunPlan(**more))
