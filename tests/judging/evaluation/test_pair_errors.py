"""Relative poses over all pairs, against loops over pairs and sorted errors."""

import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.judging.evaluation import pair_errors as pairs_module
from bundle.judging.evaluation.pair_errors import THRESHOLDS, pair_errors
from bundle.model.pose_table import PoseTable
from tests.judging.evaluation import worked_example as example


def angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def slow(estimate, reference):
    """Errors of all ordered pairs by loops."""
    errors = {}
    for i in range(len(reference)):
        for j in range(len(reference)):
            if i == j:
                continue
            rotations, directions = [], []
            for poses in (estimate, reference):
                turn = Rotation.from_quat(poses[:, :4])
                rotations.append(turn[j].inv() * turn[i])
                directions.append(turn[j].inv().as_matrix() @ (poses[i, 4:] - poses[j, 4:]))
            rotation = np.degrees((rotations[0] * rotations[1].inv()).magnitude())
            errors[i, j] = rotation, angle(*directions)
    return errors


def trapezoid(errors, limit):
    """The AUC of SuperGlue's code."""
    errors = np.r_[0.0, np.sort(errors)]
    recall = np.arange(len(errors)) / (len(errors) - 1)
    last = np.searchsorted(errors, limit)
    area = np.trapezoid(np.r_[recall[:last], recall[last - 1]], x=np.r_[errors[:last], limit])
    return area / limit


def histogram(errors, limit):
    """The AUC of VGGT's code."""
    counts, _ = np.histogram(errors, bins=np.arange(limit + 1))
    return np.mean(np.cumsum(counts / len(errors)))


@pytest.mark.parametrize("block", [1, 37, 100_000])
@pytest.mark.parametrize("noise", [0.002, 0.05])
def test_all_definitions_equal_their_codes(monkeypatch, block, noise):
    monkeypatch.setattr(pairs_module, "BLOCK", block)
    truth = example.path(17)
    estimate = example.noisy(truth, noise, 1.0)
    found = pair_errors(estimate.poses, truth.poses)
    errors = slow(estimate.poses, truth.poses)
    forward = np.array([max(error) for (i, j), error in errors.items() if i < j])
    ordered = np.array([max(error) for error in errors.values()])
    rotation = np.array([error[0] for (i, j), error in errors.items() if i < j])
    translation = np.array([error[1] for (i, j), error in errors.items() if i < j])
    assert found.num_pairs == 17 * 16 // 2
    for limit in THRESHOLDS:
        key = str(limit)
        assert found.auc["trapezoid"][key] == pytest.approx(trapezoid(forward, limit), abs=1e-9)
        assert found.auc["colmap"][key] == pytest.approx(trapezoid(ordered, limit), abs=1e-9)
        assert found.auc["histogram"][key] == pytest.approx(histogram(forward, limit), abs=1e-12)
        area = np.maximum(0, 1 - forward / limit).mean()
        assert found.auc["integral"][key] == pytest.approx(area, abs=1e-9)
        assert found.rotation_accuracy[key] == pytest.approx((rotation < limit).mean())
        assert found.translation_accuracy[key] == pytest.approx((translation < limit).mean())


def test_missing_images_have_errors_of_180_degrees_in_colmaps_definition():
    truth = example.path(12)
    estimate = example.noisy(truth)
    part = pair_errors(estimate.poses[:9], truth.poses[:9], num_missing=3)
    errors = slow(estimate.poses[:9], truth.poses[:9])
    ordered = np.r_[[max(error) for error in errors.values()], np.full(12 * 11 - 9 * 8, 180.0)]
    assert part.auc["colmap"]["10"] == pytest.approx(trapezoid(ordered, 10), abs=1e-9)
    whole = bundle.evaluate(PoseTable(estimate.poses[:9], estimate.names[:9]), truth)
    assert whole.pairs.auc == part.auc


def test_cameras_in_one_place():
    truth = example.path(8).poses.copy()
    truth[1, 4:] = truth[0, 4:]
    estimate = truth.copy()
    estimate[1, 4:] += 0.5  # no direction in the reference: the rotation decides
    found = pair_errors(estimate, truth)
    assert found.num_pairs_at_one_place == 1
    same = pair_errors(truth, truth)
    assert set(same.auc["integral"].values()) == {1.0}
    collapsed = truth.copy()
    collapsed[:, 4:] *= 1e-30
    collapsed[3, 4:] = 1.0
    assert pair_errors(collapsed, truth).translation_accuracy["30"] < 0.5


def test_rotations_only_of_180_degrees():
    truth = example.path(6).poses
    turned = truth.copy()
    turned[0, :4] = (
        Rotation.from_quat(truth[0, :4]) * Rotation.from_rotvec([np.pi, 0, 0])
    ).as_quat()
    assert pair_errors(turned, truth).rotation_accuracy["30"] == pytest.approx(10 / 15)


def test_both_quaternions_of_a_rotation_have_the_same_errors():
    truth = example.path(9)
    estimate = example.noisy(truth).poses.copy()
    found = pair_errors(estimate, truth.poses)
    estimate[1::2, :4] *= -1
    assert pair_errors(estimate, truth.poses) == found


def test_the_order_of_rows_and_the_world_have_no_influence():
    truth = example.path(15)
    estimate = example.noisy(truth, 0.05, 3)
    wanted = bundle.evaluate(estimate, truth)
    order = np.random.default_rng(3).permutation(15)
    mixed = PoseTable(estimate.poses[order], tuple(estimate.names[k] for k in order))
    for other in (mixed, example.moved(estimate, 1e6, (80, 1, 5), (1e6, 0, 1))):
        found = bundle.evaluate(other, truth)
        assert found.association.names == wanted.association.names
        assert found.position_errors == pytest.approx(wanted.position_errors, rel=1e-8)
        for name, auc in found.pairs.auc.items():
            assert auc == pytest.approx(wanted.pairs.auc[name], rel=1e-8)


def test_memory_does_not_grow_with_the_pairs():
    truth = example.path(1500)
    estimate = example.noisy(truth)
    tracemalloc.start()
    pair_errors(estimate.poses, truth.poses)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6  # an array over all pairs with three coordinates takes 54 MB


def test_of_many_images_evenly_spaced_ones_count(monkeypatch):
    truth = example.path(41)
    estimate = example.noisy(truth)
    part = pair_errors(estimate.poses[::4], truth.poses[::4], num_missing=2)
    monkeypatch.setattr(pairs_module, "MOST_IMAGES", 11)
    assert pair_errors(estimate.poses, truth.poses, num_missing=7) == part
