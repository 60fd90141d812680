"""Verdicts, and causes of large differences, on planted faults."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.pose_table import PoseTable
from tests.judging.evaluation.worked_example import moved, noisy, path
from tests.scenes import make_problem

TRUTH = path(30)


def kinds(found):
    return [finding.kind for finding in found.findings]


def with_poses(table, **columns):
    """A table with other centres or rotations."""
    poses = table.poses.copy()
    if "centers" in columns:
        poses[:, 4:] = columns["centers"]
    if "turns" in columns:
        poses[:, :4] = columns["turns"].as_quat()
    return PoseTable(poses, table.names, format="poses")


def turns(table):
    return Rotation.from_quat(np.array(table.poses[:, :4]))


@pytest.mark.parametrize(
    ("length", "degrees", "word"),
    [
        (0.0, 0.0, "identical"),
        (0.002, 0.2, "agrees"),
        (0.002, 1.5, "close"),
        (0.03, 0.2, "close"),
        (0.1, 0.2, "differs"),
        (0.002, 10, "differs"),
        (0.002, 70, "contradicts"),
        (3.0, 0.2, "contradicts"),
    ],
)
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_word_follows_position_and_rotation(length, degrees, word, scale):
    estimate = moved(noisy(TRUTH, length, degrees), scale, (1, 2, 3), (scale, 0, 0))
    found = bundle.evaluate(estimate, TRUTH)
    assert found.verdict == word
    assert set(kinds(found)) <= ({"near_line"} if length > 1 else set())
    assert bundle.evaluate(estimate, moved(TRUTH, 1 / scale, (9, 0, 0), (0, 0, 0))).verdict == word


@pytest.mark.parametrize("axis", range(3))
def test_a_mirrored_path_is_not_good(axis):
    mirror = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
    both = Rotation.from_matrix(mirror @ turns(TRUTH).as_matrix() @ mirror)
    for estimate in (
        with_poses(TRUTH, centers=TRUTH.poses[:, 4:] @ mirror),
        with_poses(TRUTH, centers=TRUTH.poses[:, 4:] @ mirror, turns=both),
    ):
        found = bundle.evaluate(estimate, TRUTH)
        assert found.verdict in ("differs", "contradicts")
        assert "mirrored" in kinds(found)


def test_a_path_that_is_mirrored_in_its_plane_contradicts():
    flat = TRUTH.poses[:, 4:] * [1, 1, 0]
    yaw = Rotation.from_euler("z", np.linspace(0, 3, 30)[:, None])
    plane = with_poses(TRUTH, centers=flat, turns=yaw)
    mirrored = with_poses(TRUTH, centers=flat * [1, -1, 1], turns=yaw.inv())
    found = bundle.evaluate(mirrored, plane)
    assert found.verdict == "contradicts" and kinds(found) == ["axes"]


def test_outlier_images_are_named_and_the_others_judged():
    centers = TRUTH.poses[:, 4:].copy()
    centers[[4, 20]] += [[3, 1, 2], [-5, 2, 0]]
    found = bundle.evaluate(noisy(with_poses(TRUTH, centers=centers), 0.002), TRUTH)
    (finding,) = found.findings
    assert finding.kind == "outlier_images"
    assert set(finding.evidence["images"]) == {TRUTH.names[4], TRUTH.names[20]}
    assert finding.evidence["rmse_of_others"] < 0.01
    assert finding.sentence.startswith("2 images are far off")
    numbers = tuple(map(str, range(30)))  # ids of a pose graph
    given, truth = (
        PoseTable(one.poses, numbers) for one in (with_poses(TRUTH, centers=centers), TRUTH)
    )
    (finding,) = bundle.evaluate(given, truth).findings
    assert finding.sentence.startswith("2 poses are far off")


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_small_deviations_are_no_outliers(scale):
    for shift, found in ((0.005, []), (0.5, ["outlier_images"])):
        centers = TRUTH.poses[:, 4:].copy()
        centers[7, 2] += shift
        estimate = moved(with_poses(TRUTH, centers=centers), scale, (1, 2, 3), (0, 0, 0))
        truth = moved(TRUTH, scale, (4, 0, 0), (scale, 0, 0))
        assert kinds(bundle.evaluate(noisy(estimate, 1e-5 * scale, 0.01), truth)) == found


@pytest.mark.parametrize("which", ["A", "B"])
def test_poses_of_the_opposite_direction(which):
    estimate = noisy(TRUTH)
    pair = [with_poses(estimate, **{}), with_poses(TRUTH, **{})]
    place = "AB".index(which)
    pair[place] = pair[place].inverse()
    found = bundle.evaluate(*pair)
    (finding,) = found.findings
    assert finding.kind == "direction" and which in finding.evidence["inputs"]
    assert "pose-direction" in finding.command
    assert found.verdict in ("differs", "contradicts")


def test_axes_of_another_sensor():
    estimate = noisy(TRUTH)
    other = with_poses(estimate, turns=turns(estimate) * Rotation.from_rotvec([0, np.pi / 2, 0]))
    found = bundle.evaluate(other, TRUTH)
    (finding,) = found.findings
    assert finding.kind == "axes"
    assert finding.evidence["rotation_degrees"] == pytest.approx(90, abs=1)
    assert finding.evidence["rmse_without"] < 2


@pytest.mark.parametrize(("share", "found"), [(0.19, ["axes"]), (0.21, [])])
def test_one_rotation_that_leaves_a_fifth_of_the_error_is_named(share, found):
    # About one axis by 30 + b and 30 - b degrees: b is left of sqrt(30^2 + b^2).
    left = 30 * share / np.sqrt(1 - share**2)
    angles = np.radians(30 + left * (-1.0) ** np.arange(30))
    axis = Rotation.from_rotvec(angles[:, None] * [0, 1, 0])
    assert kinds(bundle.evaluate(with_poses(TRUTH, turns=turns(TRUTH) * axis), TRUTH)) == found


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_cameras_that_turn_with_the_alignment_have_no_other_axes(count):
    part = PoseTable(TRUTH.poses[:count], TRUTH.names[:count])
    for seed in range(10):
        assert "axes" not in kinds(bundle.evaluate(noisy(part, 0.01, 0.3, seed), part))
    rng = np.random.default_rng(0)
    collapsed = with_poses(TRUTH, centers=1e-14 * rng.standard_normal((30, 3)))
    assert kinds(bundle.evaluate(collapsed, TRUTH)) == []


def test_a_path_near_a_line():
    thin = with_poses(TRUTH, centers=TRUTH.poses[:, 4:] * [1, 1e-3, 1e-3])
    found = bundle.evaluate(noisy(thin, 0.01, 0.1), thin)
    assert "near_line" in kinds(found)
    assert kinds(bundle.evaluate(noisy(thin, 1e-7, 0.1), thin)) == []


def test_millimetres_in_coordinates_of_a_map_are_no_rounding():
    utm = moved(TRUTH, 10.0, (0, 0, 1), (5e5, 5.4e6, 100))
    assert bundle.evaluate(noisy(utm, 1e-3, 0.0), utm).verdict == "agrees"
    assert bundle.evaluate(moved(utm, 1.0, (0, 0, 5), (1, 2, 3)), utm).verdict == "identical"


def test_a_reference_that_stands_still():
    still = with_poses(TRUTH, centers=np.zeros((30, 3)))
    for align in ("none", "yaw"):
        found = bundle.evaluate(TRUTH, still, align=align)
        assert found.verdict == "contradicts" and kinds(found) == []


def test_missing_images_are_counted():
    part = PoseTable(TRUTH.poses[:25], TRUTH.names[:25])
    found = bundle.evaluate(part, TRUTH)
    assert kinds(found) == ["missing_images"] and found.association.only_b == TRUTH.names[25:]
    assert found.num_shared == 25 and "25 of 30 images" in found.headline[0]
    assert kinds(bundle.evaluate(TRUTH, part)) == []


def test_healthy_models_have_no_findings():
    for seed in range(5):
        problem = make_problem(num_images=8, num_points=80, seed=seed, perturbation=0)
        refined = bundle.solve(problem).problem
        found = bundle.evaluate(refined, problem)
        assert found.findings == () and found.verdict in ("agrees", "close")
        assert len(found.headline) == 3
