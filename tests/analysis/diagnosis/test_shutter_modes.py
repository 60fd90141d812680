"""Degenerate motions under a rolling shutter: named on planted scenes, none on healthy ones."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import bundle
from bundle.analysis.diagnosis import shutter_modes as module
from bundle.analysis.diagnosis.shutter_modes import shutter_modes
from bundle.model.rigid_motions import quaternion_rotate
from bundle.model.shutter_motion import read_positions
from bundle.synthetic.video_scene import DroneGrid, film
from tests.campaigns.degenerate_shutters import HEALTHY, PLANTED, kinds, scene_of
from tests.synthetic.video.test_video_scene import algebra


def options(scene, **changes):
    fields = {"num_images": 10, "num_points": 200, "rolling_shutter": 0.8, "seed": 1}
    return bundle.SceneOptions(scene=scene, **fields | changes)


@pytest.mark.parametrize("direction", ["rows", "columns"])
def test_derivatives_are_those_of_the_fixed_point(direction):
    problem = film(options("orbit", num_images=3), direction=direction).ground_truth
    rows = np.arange(0, problem.num_observations, 40)
    jacobian, d_point, known = module.shutter_jacobians(problem, rows)
    assert known.all()
    axis = np.array([1 if direction == "rows" else 0])

    def read(row, change):
        image = problem.observation_image[row]
        pose = problem.cam_from_world[image]
        point = problem.points[problem.observation_point[row]] + change[12:]
        local = quaternion_rotate(pose[None, :4], point[None])[0] + pose[4:]
        local = (expm(algebra(change[:6])) @ np.append(local, 1))[:3]
        twist = problem.rolling_shutter.twist[image] + change[6:12]
        return read_positions(problem, np.array([image]), local[None], twist[None], axis)[0][0]

    for k, row in enumerate(rows.tolist()):
        steps = 1e-6 * np.eye(15)
        numeric = np.stack([(read(row, s) - read(row, -s)) / 2e-6 for s in steps], axis=1)
        analytic = np.hstack([jacobian[k], d_point[k]])
        np.testing.assert_allclose(numeric, analytic, atol=1e-7 * np.abs(analytic).max())


def dense_spectrum(problem, images):
    """Return the scaled eigenvalues of poses and twists by dense algebra over all unknowns."""
    rows = np.arange(problem.num_observations)
    jacobian, d_point, _ = module.shutter_jacobians(problem, rows)
    width, count = 12 * len(images), 3 * problem.num_points
    full = np.zeros((2 * len(rows), width + count))
    for k in rows.tolist():
        image, point = problem.observation_image[k], problem.observation_point[k]
        full[2 * k : 2 * k + 2, 12 * image : 12 * image + 12] = jacobian[k]
        full[2 * k : 2 * k + 2, width + 3 * point : width + 3 * point + 3] = d_point[k]
    a, b = full[:, :width], full[:, width:]
    system = a.T @ a - a.T @ b @ np.linalg.pinv(b.T @ b) @ b.T @ a
    scale = 1 / np.sqrt(np.diag(system))
    return np.linalg.eigvalsh(system * scale[:, None] * scale)


@pytest.mark.parametrize("scene", ["orbit", "street", "drone_grid"])
def test_the_spectrum_is_that_of_dense_algebra_without_the_gauge(scene):
    problem = film(options(scene, num_images=6, num_points=120)).ground_truth
    expected = dense_spectrum(problem, range(6))
    assert np.abs(expected[:7]).max() < 1e-11 < expected[7]
    found = module.shutter_spectrum(problem)
    # Interlacing: the gauge is removed from scaled unknowns.
    np.testing.assert_allclose(found.eigenvalues, expected[7:], rtol=1e-3, atol=1e-12)


def test_moving_the_world_changes_nothing():
    problem = film(options("street")).ground_truth
    expected = module.shutter_spectrum(problem).eigenvalues
    from bundle.georeference.similarity import Similarity, moved

    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    far = moved(problem, Similarity(50.0, turn, np.array([1e4, -2e4, 500.0])))
    found = module.shutter_spectrum(far).eigenvalues
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-10)


@pytest.mark.parametrize("name", HEALTHY)
def test_healthy_scenes_are_not_named(name):
    assert kinds(scene_of(name, 1)) == []


@pytest.mark.parametrize("name", PLANTED)
def test_planted_degeneracies_are_named(name):
    assert kinds(scene_of(name, 1)) == [PLANTED[name]]


@pytest.mark.parametrize("seed", [7061, 7078])
def test_long_roads_are_named(seed):
    """Their weak eigenvalues reach 3e-5."""
    assert kinds(scene_of("road", seed)) == [PLANTED["road"]]


def test_pure_translation_has_a_null_direction_per_image():
    problem = film(
        options("drone_grid", camera_model="PINHOLE", num_points=300),
        DroneGrid(np.random.default_rng(0), 10, relief=0.0),
        turning=False,
    ).ground_truth
    (mode,) = shutter_modes(problem)
    assert mode.kind == "flat_scene_pure_translation"
    assert mode.dimension == 10 and len(mode.image_ids) == 10


def test_diagnose_reports_the_mode_with_its_images():
    planted = scene_of("flat", 1)
    found = bundle.diagnose(planted)
    named = [entry for entry in found.findings if entry.kind == "flat_scene_parallel_readout"]
    assert len(named) == 1 and named[0].is_problem
    held = bundle.diagnose(planted, refine=("points",))
    assert not any("readout" in entry.kind for entry in held.findings)


@pytest.mark.parametrize(("off", "is_parallel"), [(14.9, True), (15.1, False)])
def test_readouts_are_parallel_within_fifteen_degrees_of_a_line(off, is_parallel):
    problem = film(options("orbit", num_images=2, num_points=20)).ground_truth
    poses = problem.cam_from_world.copy()
    poses[:, :4] = Rotation.from_euler("z", [[off], [180 - off]], degrees=True).as_quat()
    turned = problem.replace(cam_from_world=poses)
    assert module._is_parallel(turned, np.arange(2)) == is_parallel


@pytest.mark.parametrize(("ratio", "is_pure"), [(0.0199, True), (0.0201, False)])
def test_a_camera_that_only_translates_turns_by_a_fiftieth_of_its_shift(ratio, is_pure):
    problem = film(options("orbit", num_images=3, num_points=20)).ground_truth
    image, point = problem.observation_image, problem.observation_point
    away = np.linalg.norm(problem.points[point] - problem.projection_centers[image], axis=1)
    twist = np.zeros((3, 6))
    twist[0, 0], twist[1, 0] = ratio * 0.4 / np.median(away[image != 1]), 1.0
    twist[2, 4] = 0.4
    shutter = problem.rolling_shutter.replace(twist=twist)
    moved = problem.replace(rolling_shutter=shutter)
    assert module._only_translates(moved, np.array([0, 2])) == is_pure


def test_global_shutters_and_single_images_have_no_modes():
    problem = film(options("orbit", num_images=4)).ground_truth
    assert shutter_modes(problem.replace(rolling_shutter=None)) == []
    assert shutter_modes(problem.select(images=[0]).problem) == []
    twist = np.zeros((4, 6))
    still = bundle.RollingShutter(direction=("global",), twist=twist)
    assert shutter_modes(problem.replace(rolling_shutter=still)) == []


def test_more_images_than_are_tested(monkeypatch):
    monkeypatch.setattr(module, "MOST_IMAGES", 6)
    monkeypatch.setattr(module, "MOST_POINTS", 150)
    (mode,) = shutter_modes(scene_of("flat", 1))
    assert len(mode.image_ids) == 6 and "images were tested" in mode.sentence


@pytest.mark.parametrize(
    ("weak", "null", "flat", "images", "kind"),
    [
        # columns of 5 images: weak below the limit, null, flat
        ("11000", "00000", "11000", [0, 1], "flat_scene_parallel_readout"),
        ("11000", "00000", "10000", [], ""),  # fewer than two, since a weak image must be flat
        ("10000", "01000", "10000", [0, 1], "flat_scene_parallel_readout"),  # some weak, some null
        ("00000", "01100", "00000", [1, 2], "undetermined_twists"),
        ("01100", "01100", "01100", [1, 2], "flat_scene_pure_translation"),
    ],
)
def test_weak_images_are_flat_and_null_ones_any(monkeypatch, weak, null, flat, images, kind):
    problem = film(options("orbit", num_images=5)).ground_truth
    weak, null, flat = (np.array(list(row)) == "1" for row in (weak, null, flat))
    monkeypatch.setattr(
        module,
        "_energy",
        lambda _, limit: np.where(null if limit == module.ZERO else weak, 0.71, 0.69),
    )
    monkeypatch.setattr(module, "_flat_images", lambda *_: flat)
    found = shutter_modes(problem)
    assert [one.kind for one in found] == ([kind] if kind else [])
    if found:
        assert found[0].image_ids == tuple(problem.image_ids[images])
