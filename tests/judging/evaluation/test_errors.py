"""Errors of poses against the worked example, evo and pycolmap."""

import dataclasses
from dataclasses import astuple

import numpy as np
import pycolmap
import pytest
from evo.core import metrics
from evo.core.trajectory import PosePath3D
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.pose_alignment import align_centers, moved_poses
from bundle.georeference.similarity import Similarity
from bundle.model.pose_table import ErrorStatistics, PoseTable, absolute_errors, relative_errors
from tests.judging.evaluation import worked_example as example
from tests.scenes import make_problem


def rounded(value, wanted):
    return value == pytest.approx(wanted, abs=0.6e-9)


def test_the_worked_example_is_met_to_its_digits():
    found = bundle.evaluate(example.ESTIMATE, example.REFERENCE)
    assert rounded(found.similarity.scale, example.SCALE)
    assert rounded(found.position.rmse, example.APE[0])
    assert rounded(found.rotation.rmse, example.APE[1])
    assert rounded(found.relative.position.rmse, example.RPE[0])
    assert rounded(found.relative.rotation.rmse, example.RPE[1])
    for name, wanted in example.AUC.items():
        assert list(found.pairs.auc[name].values()) == pytest.approx(wanted, abs=0.6e-6)
    assert found.auc == found.pairs.auc["trapezoid"]
    rigid = bundle.evaluate(example.ESTIMATE, example.REFERENCE, align="rigid", auc="colmap")
    assert rounded(rigid.position.rmse, example.RIGID)
    assert rigid.auc == rigid.pairs.auc["colmap"] and rigid.auc_definition == "colmap"


def as_evo(table):
    return PosePath3D(
        positions_xyz=table.poses[:, 4:], orientations_quat_wxyz=table.poses[:, [3, 0, 1, 2]]
    )


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("align", ["similarity", "rigid", "none"])
@pytest.mark.parametrize("delta", [1, 7])
def test_errors_are_those_of_evo(scale, align, delta):
    truth = example.moved(example.path(), scale, (20, 30, 40), (scale, 0, 0))
    estimate = example.moved(example.noisy(truth, 0.01 * scale), 1.0, (1, 1, 2), (0, scale, 0))
    found = bundle.evaluate(estimate, truth, align=align, delta=delta)
    wanted, aligned = as_evo(truth), as_evo(estimate)
    if align != "none":
        aligned.align(wanted, correct_scale=align == "similarity")
    for relation, absolute, relative in (
        (metrics.PoseRelation.translation_part, found.position, found.relative.position),
        (metrics.PoseRelation.rotation_angle_deg, found.rotation, found.relative.rotation),
    ):
        ape = metrics.APE(relation)
        ape.process_data((wanted, aligned))
        rpe = metrics.RPE(relation, delta=delta, delta_unit=metrics.Unit.frames)
        rpe.process_data((wanted, aligned))
        for errors, mine in ((ape, absolute), (rpe, relative)):
            theirs = [
                errors.get_statistic(metrics.StatisticsType[k])
                for k in ErrorStatistics.__annotations__
            ]
            assert astuple(mine) == pytest.approx(theirs, rel=1e-9, abs=1e-9 * scale)


def as_graph(table, ids):
    order = np.argsort(ids)
    edges = [(k, k + 1) for k in range(len(ids) - 1)]
    identity = np.tile([0, 0, 0, 1.0, 0, 0, 0], (len(edges), 1))
    return bundle.PoseGraph(
        poses=table.poses[order],
        edges=edges,
        measurements=identity,
        information=np.tile(np.eye(6), (len(edges), 1, 1)),
        ids=np.sort(ids),
    )


@pytest.mark.parametrize("with_ids", [True, False])
def test_errors_of_pose_graphs_are_those_of_evo(with_ids):
    """The errors of motion show that id 10 comes after 9, not after 1."""
    truth, ids = example.path(12), np.arange(12)
    estimate = example.noisy(truth, 0.01)
    reference = as_graph(truth, ids) if with_ids else PoseTable(truth.poses)
    found = bundle.evaluate(as_graph(estimate, ids), reference, align="none")
    assert found.association.by == ("name" if with_ids else "order")
    for errors, mine in ((metrics.APE, found.position), (metrics.RPE, found.relative.position)):
        theirs = errors(metrics.PoseRelation.translation_part)
        theirs.process_data((as_evo(truth), as_evo(estimate)))
        assert mine.rmse == pytest.approx(theirs.get_statistic(metrics.StatisticsType.rmse))


@pytest.mark.parametrize(
    ("factor", "noise", "is_named"),
    [
        (2.0, 0, True),
        (1 + 3e-6, 0, True),
        (1.0, 0, False),
        (1.05, 1e-3, True),
        (1.002, 1e-3, False),
    ],
)
def test_a_scale_that_the_alignment_hides_is_in_the_headline(factor, noise, is_named):
    truth, ids = example.path(12), np.arange(12)
    poses = (example.noisy(truth, noise) if noise else truth).poses.copy()
    poses[:, 4:] /= factor
    estimate = PoseTable(poses)
    found = bundle.evaluate(as_graph(estimate, ids), as_graph(truth, ids))
    assert found.verdict == ("agrees" if noise else "identical")
    assert ("scaled by" in found.headline[0]) == is_named
    rigid = bundle.evaluate(as_graph(estimate, ids), as_graph(truth, ids), align="rigid")
    assert "scaled by" not in rigid.headline[0]


def test_a_model_has_no_scale_to_name():
    model = make_problem(num_images=9)
    larger = PoseTable.of_problem(model).poses.copy()
    larger[:, 4:] *= 2
    table = PoseTable(larger, names=model.image_names)
    for pair in ((table, model), (model, table)):
        found = bundle.evaluate(*pair)
        assert found.verdict == "identical" and "scaled by" not in found.headline[0]


def test_named_poses_of_a_graph_are_those_of_the_images():
    graph = dataclasses.replace(as_graph(example.REFERENCE, np.arange(4)), names=example.NAMES)
    found = bundle.evaluate(graph, example.REFERENCE)
    assert (found.verdict, found.association.by) == ("identical", "name")


def test_errors_are_those_of_pycolmap_for_the_same_transform():
    a = make_problem(num_images=9, perturbation=0.02)
    b = make_problem(num_images=9, perturbation=0.0)
    found = pycolmap.compare_reconstructions(
        a.to_pycolmap(), b.to_pycolmap(), alignment_error="proj_center", max_proj_center_error=0.1
    )
    transform = found["rec2_from_rec1"]
    similarity = Similarity(
        transform.scale, transform.rotation.matrix(), np.array(transform.translation)
    )
    tables = [PoseTable.of_problem(one).poses for one in (a, b)]
    position, rotation = absolute_errors(moved_poses(tables[0], similarity), tables[1])
    errors = {error.image_name: error for error in found["errors"]}
    for row, name in enumerate(a.image_names):
        assert rotation[row] == pytest.approx(errors[name].rotation_error_deg, abs=1e-9)
        assert position[row] == pytest.approx(errors[name].proj_center_error, abs=1e-9)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_same_poses_have_no_error_and_moved_ones_only_rounding(size):
    table = example.moved(example.path(), size, (10, 0, 0), (size, size, size))
    same = bundle.evaluate(table, table)
    assert same.verdict == "identical" and same.position.max == 0 and same.rotation.max == 0
    assert list(same.auc.values()) == pytest.approx(5 * [1.0])
    other = bundle.evaluate(example.moved(table, 1e3, (50, 60, 70), (9e3 * size, 0, 0)), table)
    assert other.verdict == "identical"
    assert other.position.max < 1e-13 * size and other.rotation.max < 1e-12
    assert other.similarity.scale == pytest.approx(1e-3)


def test_yaw_leaves_tilt_and_scale_in_the_errors():
    table = example.path()
    turned = bundle.evaluate(example.moved(table, 1.0, (0, 0, 70), (1, 2, 3)), table, align="yaw")
    assert turned.position.max < 1e-12 and turned.similarity.scale == 1
    tilted = bundle.evaluate(example.moved(table, 1.0, (3, 0, 0), (0, 0, 0)), table, align="yaw")
    assert tilted.rotation.median == pytest.approx(3, rel=0.02)


def test_the_motion_over_several_poses_does_not_overlap():
    truth = example.path(11)
    position, rotation = relative_errors(example.noisy(truth).poses, truth.poses, 5)
    assert len(position) == len(rotation) == 2


@pytest.mark.parametrize("count", [3, 10])
def test_centres_on_a_line_determine_no_similarity(count):
    table = example.path(count)
    poses = table.poses.copy()
    poses[:, 4:] = np.outer(np.arange(count), [1.0, 2, 3])
    line = PoseTable(poses, table.names)
    for pair in ((line, table), (table, line)):
        with pytest.raises(bundle.InputError, match="one line"):
            bundle.evaluate(*pair)
    assert bundle.evaluate(line, line, align="yaw").position.max == 0
    poses[:, 4:] = 5.0
    with pytest.raises(bundle.InputError, match="at one"):
        bundle.evaluate(PoseTable(poses, table.names), table)


def test_the_identity_needs_no_rounding():
    centers = 1e7 + np.random.default_rng(0).standard_normal((5, 3))
    assert np.array_equal(align_centers(centers, centers).rotation, np.eye(3))
    shifted = align_centers(centers, centers + 1.0)
    assert Rotation.from_matrix(shifted.rotation).magnitude() < 1e-8
