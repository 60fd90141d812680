"""A lens model that is too small where poses and points absorb its field: domes of flights."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import bundle
from bundle.base.tails import chi2_tail
from bundle.judging.findings import larger_lens
from bundle.judging.findings.find import find
from bundle.judging.findings.larger_lens import absorbed_lens, explains_more
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from tests.judging.findings.dense_normal_equations import Dense


def flight(model, k=-0.05, *, seed=3, images=12, points=150, noise=0.5, **more):
    """Solve a flight over flat ground, whose lens has the radial term k, with a lens model."""
    made = bundle.synthesize(
        scene="drone-grid", num_images=images, num_points=points, seed=seed, pixel_noise=noise,
        cameras="shared",
    )  # fmt: skip
    truth, params = made.ground_truth, made.ground_truth.camera_params.copy()
    observed = truth.observation_xy
    exact = bundle.project("SIMPLE_RADIAL", params[0], in_camera(truth))[0]
    params[0, 3] = k
    moved = observed - exact + bundle.project("SIMPLE_RADIAL", params[0], in_camera(truth))[0]
    start = truth.replace(observation_xy=moved, camera_params=params)
    changed = bundle.change_camera_model(start, model).problem
    return bundle.solve(changed, num_threads=1, max_num_iterations=100, **more).problem


def in_camera(problem):
    pose = problem.cam_from_world[problem.observation_image]
    turned = Rotation.from_quat(pose[:, :4].copy())
    return turned.apply(problem.points[problem.observation_point]) + pose[:, 4:]


def measured(problem, **more):
    return Measured(whole=problem, command=NextCommand(), **more)


@pytest.fixture(scope="module")
def dome():
    return flight("SIMPLE_PINHOLE")


def test_a_dome_is_found_though_hardly_any_residual_is_left(dome):
    (found,) = find(dome)
    evidence = found.evidence
    assert found.kind == "lens_model" and found.is_problem is False
    assert found.command.endswith("--camera-model SIMPLE_RADIAL")
    assert evidence["larger_model"] == "SIMPLE_RADIAL" and evidence["dof"] == 1
    assert evidence["size"] < 0.15 and evidence["p"] < 1e-4
    assert evidence["camera_movement"] > evidence["camera_sigma"]
    larger = bundle.change_camera_model(dome, "SIMPLE_RADIAL").problem
    assert find(bundle.solve(larger, num_threads=1, max_num_iterations=200).problem) == ()


def test_numbers_are_those_of_dense_least_squares(dome):
    evidence = absorbed_lens(measured(dome)).evidence
    larger = bundle.change_camera_model(dome, "SIMPLE_RADIAL").problem
    small, large = Dense(dome), Dense(larger)
    assert large.num_parameters - small.num_parameters == 1
    statistic = (large.explained - small.explained) / large.variance
    assert evidence["chi2"] == pytest.approx(statistic, rel=1e-5)
    assert evidence["p"] == pytest.approx(chi2.sf(statistic, 1), rel=1e-3)
    assert evidence["size"] == pytest.approx(np.sqrt(statistic / (2 * dome.num_observations)))
    images, centers = dome.num_images, dome.projection_centers
    by_pose = np.zeros((3 * images, 6 * images))
    for i, pose in enumerate(dome.cam_from_world):
        rotation = Rotation.from_quat(pose[:4].copy()).as_matrix()
        x, y, z = pose[4:]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        by_pose[3 * i : 3 * i + 3, 6 * i : 6 * i + 6] = -rotation.T @ np.hstack([cross, np.eye(3)])
    moves = by_pose @ (large.step[: 6 * images] - small.step[: 6 * images])
    offset = centers - centers.mean(axis=0)
    similarities = np.zeros((3 * images, 7))
    for k in range(3):
        similarities[k::3, k] = 1.0
        similarities[:, 3 + k] = np.cross(np.eye(3)[k], offset).reshape(-1)
    similarities[:, 6] = offset.reshape(-1)
    basis = np.linalg.qr(similarities)[0]
    left = np.eye(3 * images) - basis @ basis.T
    assert evidence["camera_movement"] == pytest.approx(
        np.linalg.norm(left @ moves) / np.sqrt(images), rel=1e-5
    )
    spread = left @ by_pose @ large.inverse[: 6 * images, : 6 * images] @ by_pose.T @ left
    sigma = np.sqrt(np.trace(spread) * large.variance / images)
    assert evidence["camera_sigma"] == pytest.approx(sigma, rel=1e-5)


def test_the_world_does_not_matter(dome):
    turn = Rotation.from_rotvec([0.3, -0.2, 1.0])
    poses = dome.cam_from_world.copy()
    shift, scale = np.array([300.0, -20.0, 7.0]), 50.0
    rotation = Rotation.from_quat(poses[:, :4].copy()) * turn.inv()
    poses[:, :4] = rotation.as_quat()
    poses[:, 4:] = scale * poses[:, 4:] - rotation.apply(shift)
    moved = dome.replace(
        cam_from_world=poses, points=scale * turn.apply(dome.points.copy()) + shift
    )
    one, other = (absorbed_lens(measured(problem)).evidence for problem in (dome, moved))
    assert other["chi2"] == pytest.approx(one["chi2"], rel=1e-4)
    assert other["camera_movement"] == pytest.approx(scale * one["camera_movement"], rel=1e-4)
    assert other["camera_sigma"] == pytest.approx(scale * one["camera_sigma"], rel=1e-4)


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "RADIAL", "PINHOLE"])
@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
def test_right_lenses_have_no_finding(model, loss):
    k = 0.0 if model == "PINHOLE" else -0.05
    for seed in range(4):
        options = bundle.SolveOptions(loss=loss, num_threads=1)
        right = flight(model, k, seed=seed, points=120, loss=loss)
        assert absorbed_lens(measured(right, options=options)) is None


def test_positions_with_other_sigmas_do_not_accuse_a_right_lens():
    right = flight("SIMPLE_RADIAL", noise=0.1, points=120)
    rng = np.random.default_rng(1)
    centers = right.projection_centers
    priors = [
        bundle.PositionPrior(int(image), center + 3 * rng.standard_normal(3), 1.0)
        for image, center in zip(right.image_ids, centers, strict=True)
    ]
    solved = bundle.solve(right, priors=priors, align=True, num_threads=1).problem
    assert absorbed_lens(measured(solved, priors=priors)) is None


def test_all_larger_models_are_tried_from_the_smallest():
    truth = bundle.synthesize(
        scene="orbit", num_images=10, num_points=150, seed=2, camera_model="OPENCV",
        pixel_noise=0.3,
    ).ground_truth  # fmt: skip
    params = truth.camera_params.copy()
    exact = bundle.project("OPENCV", params[0], in_camera(truth))[0]
    params[0, 6:8] = [0.01, -0.01]  # tangential
    changed = bundle.project("OPENCV", params[0], in_camera(truth))[0]
    params[0, 6:8] = 0.0
    given = truth.replace(observation_xy=truth.observation_xy - exact + changed)
    radial = bundle.change_camera_model(given, "RADIAL").problem
    solved = bundle.solve(radial, num_threads=1, max_num_iterations=100).problem
    found = absorbed_lens(measured(solved))
    assert found.evidence["larger_model"] == "OPENCV" and found.evidence["dof"] == 3


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 5, 8, 21])
@pytest.mark.parametrize("value", [0.1, 3.0, 30.0, 200.0])
def test_tail_of_chi2(value, degrees):
    assert chi2_tail(value, degrees) == pytest.approx(chi2.sf(value, degrees), rel=1e-10)
    assert chi2_tail(0.0, degrees) == chi2_tail(-1.0, degrees) == 1.0


class Scripted:
    """Step with given numbers."""

    def __init__(self, distance, num_parameters=10, moved=2.0, sigma=1.0):
        self.squared_distance, self.num_parameters = distance, num_parameters
        self.decrease, self.variance, self.num_residuals = 0.0, 1.0, 100
        self.moves, self._sigma = np.array([[moved, 0.0, 0.0]]), sigma

    def moves_beyond(self, other):
        return self.moves - other.moves

    def position_sigma(self):
        return self._sigma


QUANTILE = {count: float(chi2.isf(1e-4, count)) for count in (1, 2, 5)}


def decided(monkeypatch, dome, steps):
    """Return the model that is proposed for given steps of the larger models."""
    given = dict(zip(("SIMPLE_RADIAL", "RADIAL", "OPENCV"), steps, strict=True))
    present = Scripted(0.0, 10, moved=0.0)
    monkeypatch.setattr(larger_lens, "_extended", lambda _, name: given[name])
    monkeypatch.setattr(larger_lens, "Step", lambda *_: present)
    found = absorbed_lens(measured(dome))
    return found and found.evidence["larger_model"]


def test_each_threshold_from_both_sides(monkeypatch, dome):
    low, high = 1 - 1e-6, 1 + 1e-6

    def decide(one, two, five, **more):
        last = Scripted(five, 15, **more)
        return decided(
            monkeypatch, dome, [Scripted(one, 11, **more), Scripted(two, 12, **more), last]
        )

    assert decide(high * QUANTILE[1], 99.0, 99.0) == "SIMPLE_RADIAL"
    assert decide(low * QUANTILE[1], high * QUANTILE[2], 99.0) == "RADIAL"
    assert decide(low * QUANTILE[1], low * QUANTILE[2], high * QUANTILE[5]) == "OPENCV"
    assert decide(low * QUANTILE[1], low * QUANTILE[2], low * QUANTILE[5]) is None
    assert decide(99.0, 99.0, low * QUANTILE[1]) is None  # no other can pass
    assert decide(99.0, 99.0, high * QUANTILE[1]) == "SIMPLE_RADIAL"
    many = [Scripted(0.0, 11), Scripted(low * 200.0, 60), Scripted(high * 400.0, 110)]
    assert decided(monkeypatch, dome, many) == "OPENCV"  # 4 per term
    many[1] = Scripted(high * 200.0, 60)
    assert decided(monkeypatch, dome, many) == "RADIAL"
    assert decide(99.0, 99.0, 99.0, moved=1.0 + 1e-6) == "SIMPLE_RADIAL"
    assert decide(99.0, 99.0, 99.0, moved=1.0 - 1e-6) is None


def test_a_lens_explains_more_by_its_parameters(monkeypatch, dome):
    # A lens with five terms and lambda^2 / s^2 of 40 against velocities with 12 and 53.999 to 54.
    tried = []
    monkeypatch.setattr(
        larger_lens, "_extended", lambda _, name: tried.append(name) or Scripted(40.0, 15)
    )
    assert explains_more(measured(dome), Scripted(54.0, 22))
    assert not explains_more(measured(dome), Scripted(54.001, 22))
    assert tried == ["OPENCV"] * 2
    largest = bundle.change_camera_model(dome, "OPENCV").problem
    assert not explains_more(measured(largest), Scripted(0.0, 22))
    monkeypatch.setattr(larger_lens, "_extended", lambda *_: None)
    assert not explains_more(measured(dome), Scripted(0.0, 22))


def test_models_that_are_not_tested(monkeypatch, dome):
    held = bundle.SolveOptions(refine=("poses", "points", "focal"))
    assert absorbed_lens(measured(dome, options=held)) is None
    split = bundle.split_cameras(dome)
    four = split.replace(image_camera=np.minimum(split.image_camera, 3))
    five = split.replace(image_camera=np.minimum(split.image_camera, 4))
    assert absorbed_lens(measured(four)).evidence["camera_ids"] == four.camera_ids[:4].tolist()
    monkeypatch.setattr(larger_lens, "_found", lambda *_: "found")
    assert absorbed_lens(measured(five)) is None
    assert absorbed_lens(measured(five), has_hint=True) == "found"
    work = dome.num_observations + 20 * dome.num_images**2
    monkeypatch.setattr(larger_lens, "MOST_WORK", work)
    assert absorbed_lens(measured(dome)) is not None
    monkeypatch.setattr(larger_lens, "MOST_WORK", work - 1)
    assert absorbed_lens(measured(dome)) is None


def test_lenses_of_several_models_are_not_tested(dome):
    split = bundle.split_cameras(dome)
    two = split.replace(image_camera=np.minimum(split.image_camera, 1))
    mixed = bundle.change_camera_model(two, "RADIAL", camera_ids=[int(two.camera_ids[0])]).problem
    assert absorbed_lens(measured(mixed)) is None
    assert absorbed_lens(measured(two)) is not None
