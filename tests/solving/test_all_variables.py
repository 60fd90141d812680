"""Every array that a solve estimates: all that carries the state of a solve carries it.

The problem has all kinds of variables at once: rigs whose sensors move, images alone, lenses,
points, tied twists and refined readouts. Arrays are found by their type here, not by the table.
"""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.judging.validation.candidate_fits import Fitting, fit_candidates
from bundle.judging.validation.candidates import Candidate
from bundle.model.estimates import VARIABLES, estimates, with_estimates
from bundle.model.folds import folds_of
from bundle.model.rigid_motions import rotation_matrices
from bundle.planning.comparison import process
from bundle.solving.rounds import input_digest
from bundle.solving.slices.sliced_refinement import OutOfCoreRefinement, scratch_folder
from tests.rig_scenes import rig_problem
from tests.rolling import filmed
from tests.solving.ranks.thread_crew import processes

TIED = {"twists": "tied", "twist_sigma": (0.01, 0.05)}
OPTIONS = bundle.SolveOptions(
    deterministic=True,
    num_threads=1,
    max_num_iterations=12,
    **TIED,
    refine_readout=True,
    refine_sensor_from_rig=True,
    gauge="two_cameras",
)
FREE = OPTIONS.replace(twists="free", twist_sigma=(), refine_readout=False)
ESTIMATED = {
    *("cam_from_world", "camera_params", "points", "rig_from_world", "sensor_from_rig"),
    *("twist", "readout"),
}


def arrays(problem):
    """Return every array of numbers of a problem and of its rolling shutter by name."""
    found = {**vars(problem), **vars(problem.rolling_shutter)}
    return {
        name: value
        for name, value in found.items()
        if isinstance(value, np.ndarray) and value.dtype == np.float64
    }


def assert_same(one, other, *, rtol=0.0):
    a, b = arrays(one), arrays(other)
    assert a.keys() == b.keys() >= ESTIMATED
    for name in a:
        np.testing.assert_allclose(a[name], b[name], rtol=rtol, atol=rtol, err_msg=name)


def make(**changes):
    """Two frames of a stereo rig with global shutters, and eight images alone that roll."""
    rigs = rig_problem(num_frames=2, num_alone=8, num_points=40, seed=5, perturbation=2e-3)
    alone = rigs.image_frame < 0
    direction = np.where(np.isin(np.arange(rigs.num_cameras), rigs.image_camera[alone]), 1, 0)
    names = tuple(("global", "rows")[one] for one in direction)
    made = filmed(rigs, direction=names, ties=True, readout=0.5, seed=6, **changes)
    shutter = made.rolling_shutter
    first = int(np.flatnonzero(alone)[0])
    neighbours = np.where(alone[:, None], np.maximum(shutter.neighbours, first), -1)
    shutter = shutter.replace(
        readout=np.where(direction, 0.5, np.nan),
        neighbours=neighbours.astype(np.int32),
        frames=np.where(alone, shutter.frames, np.nan),
    )
    return made.replace(rolling_shutter=shutter)


@pytest.fixture(scope="module")
def problem():
    return make()


@pytest.fixture(scope="module")
def plain(problem):
    result = bundle.solve(problem, OPTIONS)
    assert result.summary.is_solution_usable
    return result


def test_the_table_names_all_that_a_solve_changes(problem, plain):
    before, after = arrays(problem), arrays(plain.problem)
    changed = {name for name in before if not np.array_equal(before[name], after[name], True)}
    assert changed == ESTIMATED == {one.name for one in VARIABLES}
    assert estimates(problem).keys() == ESTIMATED
    for one in VARIABLES:
        rows = getattr(problem, f"num_{one.rows}")
        width = one.width or problem.camera_params.shape[1]
        assert before[one.name].reshape(rows, -1).shape == (rows, width), one.name


def test_tangent_sizes_are_those_of_the_solver(problem):
    def columns(given, **options):
        how = {"gauge": "none", "linear_solver_type": "dense_schur", "max_num_iterations": 0}
        return bundle.solve(given, **{**how, **options}).summary.num_factor_columns

    tangent = {one.kind: one.tangent for one in VARIABLES}
    alone = int((problem.image_frame < 0).sum())
    still = problem.replace(rolling_shutter=None)
    cameras = 2 * problem.num_cameras  # fx and fy; the principal point is constant
    cameras += tangent["image"] * alone + tangent["frame"] * problem.num_frames
    assert columns(still) == cameras
    assert columns(problem) == cameras + tangent["twist"] * alone
    assert columns(still, refine_sensor_from_rig=True) == cameras + tangent["sensor"]
    tied = {**TIED, "gauge": "two_cameras"}
    both = columns(problem, **tied)
    assert columns(problem, **tied, refine_readout=True) == both + tangent["readout"] * alone


@pytest.mark.parametrize("name", sorted(ESTIMATED))
def test_a_digest_covers_each_array(problem, name):
    values = {key: value.copy() for key, value in estimates(problem).items()}
    if name in ("readout", "twist"):
        row = np.flatnonzero(problem.rolling_shutter.is_rolling)[0]
        row = row if name == "readout" else np.flatnonzero(problem.image_camera == row)[0]
        values[name][row] *= 1 + 1e-15 * 4
    else:
        values[name].flat[-1] = np.nextafter(values[name].flat[-1], 9)
    changed = with_estimates(problem, values)
    assert not np.array_equal(values[name], estimates(problem)[name], True)
    assert input_digest.digest(changed) != input_digest.digest(problem)
    assert input_digest.digest(with_estimates(changed, estimates(problem))) == input_digest.digest(
        problem
    )


def test_executors(problem, plain):
    solver = bundle.Solver(problem, OPTIONS)
    assert_same(solver.solve().problem, plain.problem)
    # From the values of another problem, all of which the solver takes over.
    start = bundle.solve(problem, OPTIONS, max_num_iterations=1).problem
    from_there = solver.solve(start).problem
    assert_same(from_there, bundle.solve(start, OPTIONS).problem)
    assert not np.array_equal(from_there.rolling_shutter.twist, plain.problem.rolling_shutter.twist)
    with processes(2):
        divided = bundle.solve(problem, OPTIONS)
    assert divided.summary.warning_kinds == ("one_process",)
    assert_same(divided.problem, plain.problem)


class KillError(Exception):
    """Stands for a kill."""


@pytest.mark.parametrize("rounds", [0, 2])
def test_runs_that_were_killed_or_had_ended(problem, tmp_path, rounds):
    how = {"options": OPTIONS, "num_rounds": rounds, "max_error": 1.1, "checkpoint_interval": 2}
    expected = bundle.solve_rounds(problem, checkpoint=tmp_path / "whole.npz", **how)
    again = bundle.solve_rounds(problem, resume=tmp_path / "whole.npz", **how)
    assert_same(again.problem, expected.problem)
    steps = iter(range(100))

    def progress(_):
        if next(steps) == 5:
            raise KillError

    killed = tmp_path / "killed.npz"
    with pytest.raises(KillError):
        bundle.solve_rounds(problem, checkpoint=killed, progress=progress, **how)
    for _ in range(2):
        assert_same(bundle.solve_rounds(problem, resume=killed, **how).problem, expected.problem)


def test_rounds_that_remove_nothing(problem, plain):
    run = bundle.solve_rounds(problem, OPTIONS, num_rounds=1, max_error=1e3, min_angle=0)
    assert_same(run.problem, plain.problem)


def test_held_out_errors_are_those_of_a_fit_without_them(problem):
    options = OPTIONS.replace(max_num_iterations=100, function_tolerance=1e-14)
    printed = bundle.solve(problem, options, hold_out=15, hold_out_seed=3).held_out
    kept, held = bundle.hold_out(problem, percent=15, seed=3)
    fitted = bundle.solve(kept, options).problem
    values = {name: arrays(fitted)[name] for name in ESTIMATED if name not in ("twist", "readout")}
    whole = problem.replace(**values, rolling_shutter=fitted.rolling_shutter)
    errors, _ = bundle.reprojection_errors(whole)
    mask = np.zeros(problem.num_observations, bool)
    mask[held] = True
    for found, expected in ((printed, errors[mask]), (printed.fitted, errors[~mask])):
        assert found.rmse == pytest.approx(np.sqrt((expected**2).mean()), rel=1e-6)
    # The twists matter: with those of the input the errors are other ones.
    still = problem.replace(**values)
    assert np.sqrt((bundle.reprojection_errors(still)[0] ** 2).mean()) > 1.1 * printed.fitted.rmse


def test_folds_of_a_validation(problem):
    folds = folds_of(problem, 4, 0)
    options = OPTIONS.replace(max_num_iterations=100, function_tolerance=1e-14)
    one = Candidate(camera_model="PINHOLE", share="input", loss="trivial", refine=options.refine)
    (fit,) = fit_candidates([one], Fitting(problem=problem, folds=folds, options=options))
    assert fit.error == ""
    assert_same(fit.refined, bundle.solve(problem, options).problem, rtol=1e-6)
    for fold in range(4):
        kept = problem.select(observations=folds != fold).problem
        fitted = bundle.solve(kept, options).problem
        whole = with_estimates(problem, estimates(fitted), checked=True)
        expected = bundle.reprojection_errors(whole)[0][folds == fold]
        found = np.linalg.norm(fit.held_out[folds == fold], axis=1)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)


def test_a_local_part(problem):
    """The named images move; all else, the neighbours' twists too, stays bit for bit."""
    ids = problem.image_ids[problem.image_frame < 0][2:5]
    options = FREE.replace(max_num_iterations=50)
    result = bundle.solve_rounds(problem, options, num_rounds=0, only_images=ids.tolist())
    named = np.isin(problem.image_ids, ids)
    before, after = arrays(problem), arrays(result.problem)
    for name in ("cam_from_world", "twist"):
        np.testing.assert_array_equal(before[name][~named], after[name][~named], err_msg=name)
        assert (before[name][named] != after[name][named]).any(axis=1).all(), name
    for name in ("rig_from_world", "sensor_from_rig", "readout"):
        np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    # The merged model has the cost that the solver ended with.
    errors, _ = bundle.reprojection_errors(result.problem)
    assert 0.5 * (errors**2).sum() == pytest.approx(result.summary.final_cost, rel=1e-9)
    # The solve of all images with the others held has the same minimum.
    held = options.replace(
        fixed_image_ids=problem.image_ids[~named].tolist(),
        fixed_camera_ids=np.delete(problem.camera_ids, problem.image_camera[named]).tolist(),
        refine_sensor_from_rig=False,
    )
    assert_same(bundle.solve(problem, held).problem, result.problem, rtol=1e-6)


def test_a_part_that_is_put_back(problem, plain):
    ids = np.arange(2, problem.num_images)  # an image of the second frame's sensor stays outside
    part = problem.select(images=ids)
    values = estimates(plain.problem.select(images=ids).problem)
    whole = part.put_back(problem, with_estimates(part.problem, values, checked=True))
    before, after, given = arrays(problem), arrays(whole), arrays(plain.problem)
    for name in ("sensor_from_rig", "points"):
        np.testing.assert_array_equal(after[name], given[name], err_msg=name)
    for name in ("cam_from_world", "twist"):
        np.testing.assert_array_equal(after[name][ids], given[name][ids], err_msg=name)
    cameras = part.cameras
    for name in ("camera_params", "readout"):
        np.testing.assert_array_equal(after[name][cameras], given[name][cameras], err_msg=name)
    np.testing.assert_array_equal(after["twist"][:2], before["twist"][:2])
    # An image outside of the part that the moved sensor carries moves with it.
    outside = np.flatnonzero(problem.image_sensor[:2] >= 0)
    assert (
        len(outside)
        and (after["cam_from_world"][outside] != given["cam_from_world"][outside]).any()
    )
    assert (after["cam_from_world"][outside] != before["cam_from_world"][outside]).any()


def test_a_similarity(plain):
    """Pixels stay, arrays move as derived here with matrices, and the inverse restores them."""
    turn = Rotation.from_rotvec([0.3, -0.8, 1.1]).as_matrix()
    there = Similarity(2.5, turn, np.array([4.0, -3.0, 10.0]))
    back = Similarity(1 / 2.5, turn.T, -turn.T @ there.translation / 2.5)
    model = plain.problem
    other = moved(model, there)
    errors, same = (bundle.reprojection_errors(one)[0] for one in (model, other))
    np.testing.assert_allclose(same, errors, atol=1e-8)
    a, b = arrays(model), arrays(other)
    np.testing.assert_allclose(b["points"], 2.5 * a["points"] @ turn.T + there.translation)
    for name in ("cam_from_world", "rig_from_world"):
        old, new = (rotation_matrices(of[name][:, :4]) for of in (a, b))
        np.testing.assert_allclose(new, old @ turn.T, atol=1e-9)
        shift = 2.5 * a[name][:, 4:] - new @ there.translation
        np.testing.assert_allclose(b[name][:, 4:], shift, atol=1e-9)
    for name, lengths in (("sensor_from_rig", slice(4, 7)), ("twist", slice(3, 6))):
        factor = np.ones(a[name].shape[1])
        factor[lengths] = 2.5
        np.testing.assert_allclose(b[name], factor * a[name], rtol=1e-12)
    for name in ("camera_params", "readout"):
        np.testing.assert_array_equal(a[name], b[name])
    again = moved(other, back)
    for name in ESTIMATED:
        old, new = arrays(model)[name], arrays(again)[name]
        if name.endswith(("_world", "_rig")):  # q and -q are one rotation
            signs = np.sign((old[:, :4] * new[:, :4]).sum(axis=1))[:, None]
            new = np.hstack([signs * new[:, :4], new[:, 4:]])
        np.testing.assert_allclose(new, old, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("format", ["colmap", "colmap-text"])
def test_files(plain, tmp_path, format):
    bundle.save(plain.problem, tmp_path / "model", format=format)
    again = bundle.load(tmp_path / "model")
    assert_same(again, plain.problem, rtol=1e-12)
    bundle.save(again, tmp_path / "twice", format=format)
    assert_same(bundle.load(tmp_path / "twice"), again)


def test_processes_of_a_comparison(problem, plain, tmp_path):
    process.store(problem, tmp_path / "0")
    given = process.restore(tmp_path / "0")
    assert_same(given, problem)
    for field in dataclasses.fields(problem.rolling_shutter):
        one, other = (getattr(of.rolling_shutter, field.name) for of in (given, problem))
        np.testing.assert_array_equal(one, other, err_msg=field.name)
    process.store_solution(plain.problem, tmp_path / "0.npz")
    assert_same(process.restore_solution(given, tmp_path / "0.npz"), plain.problem)


def test_out_of_core(problem, tmp_path):
    """Ties are refused on disk (``tests/cli``), so that twists are free here."""
    bundle.save(problem, tmp_path / "model", format="colmap")
    model = bundle.load(tmp_path / "model")
    expected = bundle.solve(model, FREE)
    with scratch_folder(str(tmp_path)):
        refinement = OutOfCoreRefinement(tmp_path / "model", str(tmp_path))
        result = refinement.solve(FREE, None)
        assert_same_states(result.problem, expected.problem)
        refinement.save(tmp_path / "out")
        refinement.measure(result)
    assert_same(bundle.load(tmp_path / "out"), expected.problem, rtol=1e-12)
    assert result.rmse_global_shutters == pytest.approx(expected.rmse_global_shutters, rel=1e-12)
    before, after = result.reprojection_error_before, result.reprojection_error_after
    assert before.rmse == pytest.approx(expected.reprojection_error_before.rmse, rel=1e-12)
    assert after.rmse == pytest.approx(expected.reprojection_error_after.rmse, rel=1e-12)


def assert_same_states(one, other):
    for name in ESTIMATED:
        np.testing.assert_array_equal(arrays(one)[name], arrays(other)[name], err_msg=name)
