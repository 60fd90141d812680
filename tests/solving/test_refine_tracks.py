"""Tracks that are completed, merged and triangulated with the matches of a database."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.solving import refine_tracks as chapter
from bundle.solving.rounds import solve_rounds
from tests.track_scenes import DAMAGES, damaged, synthesize


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[bundle.Problem, Path]:
    """The truth and its database."""
    folder = tmp_path_factory.mktemp("scene")
    return synthesize(folder), folder / "database.db"


def error_of_centres(model: bundle.Problem, truth: bundle.Problem) -> float:
    return bundle.evaluate(model, truth).position.rmse


def check_model(model: bundle.Problem, database: Path) -> pycolmap.Reconstruction:
    """Check the written model with pycolmap: references, keypoints, indices."""
    made = model.to_pycolmap()
    assert made.is_valid()
    assert made.compute_num_observations() == model.num_observations
    with pycolmap.Database.open(database) as opened:
        for image in made.images.values():
            keypoints = opened.read_keypoints(opened.read_image_with_name(image.name).image_id)
            pixels = np.array([point.xy for point in image.points2D])
            np.testing.assert_allclose(pixels, keypoints[:, :2], atol=1e-3)
    return made


@pytest.mark.parametrize("kind", DAMAGES)
def test_damaged_tracks_become_those_of_the_truth(scene, kind):
    truth, database = scene
    start = damaged(truth, kind)
    result = bundle.refine_tracks(start, database)
    model = result.problem
    alone = bundle.solve(start, loss="soft_l1").problem
    assert error_of_centres(model, truth) < 0.9 * error_of_centres(alone, truth)
    made = check_model(model, database)
    # Each track has exactly the keypoints of one true point.
    true_point = {
        (image, keypoint): point
        for image, keypoint, point in zip(
            truth.observation_image, truth.observation_keypoint, truth.observation_point,
            strict=True,
        )
    }  # fmt: skip
    tracks = [
        true_point.get(key, -1)
        for key in zip(model.observation_image, model.observation_keypoint, strict=True)
    ]
    pairs = set(zip(model.observation_point.tolist(), tracks, strict=True))
    assert model.num_observations >= 0.99 * truth.num_observations
    assert model.num_points == len(pairs) == made.num_points3D()
    assert truth.num_points <= model.num_points <= 1.01 * truth.num_points
    # The held-out error falls; wrong observations are among those held out of "merges".
    first, last = result.tracks[0].held_out_rmse, result.held_out.clipped_rmse
    assert last < 0.98 * first


def test_counts_of_the_rounds_add_up(scene):
    truth, database = scene
    start = damaged(truth, "observations")
    result = bundle.refine_tracks(start, database, max_error=2.0, hold_out=0)
    tracks = result.tracks
    assert [one.round for one in tracks] == list(range(1, len(tracks) + 1))
    assert [one.round for one in result.rounds] == [one.round for one in tracks]
    assert (tracks[0].triangulated, tracks[0].completed, tracks[0].merged) == (0, 0, 0)
    assert tracks[0].num_observations == start.num_observations - tracks[0].deleted
    assert tracks[0].deleted > 0
    for before, after, done in zip(tracks, tracks[1:], result.rounds[1:], strict=False):
        added = done.num_observations - before.num_observations
        assert 0 <= added <= after.triangulated + after.completed
        assert after.num_observations == done.num_observations - after.deleted
        assert done.num_observations_removed == after.deleted
    assert tracks[-1].num_observations == result.problem.num_observations
    assert tracks[-1].num_points == result.problem.num_points
    assert {one.held_out_rmse for one in tracks} == {None}
    # The triangulator has the limit of the filter: it does not add what is deleted.
    assert tracks[-1].completed + tracks[-1].deleted < 0.01 * result.problem.num_observations
    errors, _ = bundle.reprojection_errors(result.problem)
    assert errors.max() < 2.05


def test_the_end_is_adjusted_without_what_the_last_filter_deleted(scene):
    truth, database = scene
    start = damaged(truth, "observations")
    result = bundle.refine_tracks(start, database, num_rounds=2, max_error=1.5, hold_out=0)
    assert result.tracks[-1].deleted > 0
    assert result.summary.num_residual_blocks == result.problem.num_observations
    again = bundle.solve(result.problem)
    assert again.summary.final_cost == pytest.approx(result.summary.final_cost, rel=1e-6)


def test_rows_find_each_kept_observation(scene):
    truth, database = scene
    start = damaged(truth, "merges")
    result = bundle.refine_tracks(start, database, max_error=2.0, hold_out=0)
    model, mask, rows = result.problem, result.observation_mask, result.observation_rows
    for name in ("observation_image", "observation_keypoint"):
        np.testing.assert_array_equal(getattr(start, name)[mask], getattr(model, name)[rows])
    # The database rounds pixels to float32.
    np.testing.assert_allclose(
        start.observation_xy[mask], model.observation_xy[rows], rtol=0, atol=1e-4
    )
    kept, deleted = result.kept, result.deleted
    assert 0 < deleted.num_observations == (~mask).sum() == start.num_observations - len(rows)
    assert kept.num_observations == len(rows)
    before, _ = bundle.reprojection_errors(start)
    after, _ = bundle.reprojection_errors(model)
    assert kept.before.rmse == pytest.approx(np.sqrt(np.mean(before[mask] ** 2)), rel=1e-9)
    assert kept.after.rmse == pytest.approx(np.sqrt(np.mean(after[rows] ** 2)), rel=1e-9)
    assert result.reprojection_error_after.num_observations == model.num_observations
    seen = np.bincount(start.observation_point)
    left = np.bincount(start.observation_point[mask], minlength=len(seen))
    assert deleted.num_points == ((seen > 0) & (left == 0)).sum()
    again = pickle.loads(pickle.dumps(result))
    assert again.tracks == result.tracks
    np.testing.assert_array_equal(again.observation_rows, rows)


def test_result_is_that_of_colmaps_mapper(scene):
    """COLMAP finds the same tracks and cameras, and changes nothing in ours."""
    truth, database = scene
    start = damaged(truth, "split")
    ours = bundle.refine_tracks(start, database, hold_out=0).problem
    theirs, again = (refined_by_colmap(model, database) for model in (start, ours))
    assert abs(ours.num_points - theirs.num_points) <= 2
    assert abs(ours.num_observations - theirs.num_observations) <= 2
    difference = error_of_centres(ours, theirs)
    assert difference < 0.05 * error_of_centres(theirs, truth)
    assert (again.num_points, again.num_observations) == (ours.num_points, ours.num_observations)
    assert error_of_centres(again, ours) < 1e-6


def refined_by_colmap(start: bundle.Problem, database: Path) -> bundle.Problem:
    with pycolmap.Database.open(database) as opened:
        cache = pycolmap.DatabaseCache.create(opened, pycolmap.DatabaseCacheOptions())
    mapper, model = pycolmap.IncrementalMapper(cache), start.to_pycolmap()
    mapper.begin_reconstruction(model)
    options = pycolmap.IncrementalTriangulatorOptions()
    for image_id in model.reg_image_ids():
        mapper.triangulate_image(options, image_id)
    adjustment = pycolmap.BundleAdjustmentOptions(print_summary=False)
    mapper.iterative_global_refinement(
        5, 5e-4, pycolmap.IncrementalMapperOptions(), adjustment, options
    )
    mapper.end_reconstruction(False)
    return bundle.Problem.from_pycolmap(model)


def test_complete_tracks_stay(scene):
    truth, database = scene
    result = bundle.refine_tracks(truth, database, max_error=10.0, hold_out=0)
    assert [(one.triangulated, one.merged, one.deleted) for one in result.tracks] == [(0, 0, 0)] * 2
    np.testing.assert_array_equal(result.problem.observation_point, truth.observation_point)
    alone = bundle.solve(truth).problem
    assert error_of_centres(result.problem, alone) < 1e-6


def test_held_out_keypoints_take_no_part(scene):
    """The second run has no matches of the keypoints, nor of others at their places."""
    truth, database = scene
    matches = chapter.database_matches(database, truth.image_names)
    twin = matches.keypoints[0].copy()
    twin[1] = twin[0]
    matches = matches._replace(keypoints=[twin, *matches.keypoints[1:]])
    held = (truth.observation_image == 0) & (truth.observation_keypoint == 0)
    assert held.sum() == 1
    left = chapter._without(matches, truth, held)
    for (a, b, before), (_, _, after) in zip(matches.pairs, left.pairs, strict=True):
        gone = np.isin(before[:, 0], (0, 1)) if a == 0 else np.isin(before[:, 1], (0, 1))
        gone &= 0 in (a, b)
        np.testing.assert_array_equal(after, before[~gone])


def test_the_second_run_has_as_many_rounds_as_the_first(scene):
    truth, database = scene
    matches = chapter.database_matches(database, truth.image_names)
    limits = chapter.RoundOptions(num_rounds=4, max_error=10.0)
    for are_counted, count in ((True, 2), (False, 4)):
        request = chapter.SolveRequest(problem=truth)
        seen: list[bundle.Problem] = []
        tracks = chapter._Tracks(
            request, limits, matches, lambda _: None, seen.append, are_counted=are_counted
        )
        result = tracks.run(truth)
        assert len(seen) == len(result.tracks) == len(result.rounds) == count


def test_predictions_are_at_the_point_of_most_observations(scene):
    """One track is cut 2 to n - 3, one is lost: it is triangulated from what is not held out."""
    truth, _ = scene
    solved = bundle.solve(truth).problem
    rows = [np.flatnonzero(truth.observation_point == point) for point in (0, 1)]
    held = np.zeros(truth.num_observations, bool)
    held[[rows[0][0], rows[1][0]]] = True
    point = solved.observation_point.copy()
    point[rows[0][1:3]] = 2  # observations of another point's track
    lost = solved.replace(observation_point=point).select(
        observations=~held & (truth.observation_point != 1)
    )
    predicted = chapter._predicted(truth, held, lost.problem, bundle.SolveOptions())
    np.testing.assert_array_equal(predicted.cam_from_world, solved.cam_from_world)
    np.testing.assert_array_equal(predicted.points[0], solved.points[0])
    np.testing.assert_array_equal(predicted.points[2:], solved.points[2:])
    assert 0 < np.linalg.norm(predicted.points[1] - solved.points[1]) < 0.02
    assert np.linalg.norm(predicted.points[1] - truth.points[1]) > 0


def test_held_out_errors_are_predictions(scene):
    """Pixels of held-out observations that are far off do not change the second run."""
    truth, database = scene
    start = damaged(truth, "observations")
    result = bundle.refine_tracks(start, database, hold_out=20, hold_out_seed=5)
    expected, held = bundle.hold_out(start, percent=20, seed=5)
    record = result.held_out
    assert (record.percent, record.seed, record.num_observations) == (20, 5, len(held))
    assert record.fitted.num_observations < result.problem.num_observations
    assert record.is_converged
    scores = [one.held_out_rmse for one in result.tracks]
    assert scores[-1] == pytest.approx(record.clipped_rmse, abs=0.01)
    alone = bundle.solve(expected, loss="soft_l1").problem
    errors, _ = bundle.reprojection_errors(
        start.replace(
            cam_from_world=alone.cam_from_world, camera_params=alone.camera_params,
            points=alone.points,
        )
    )  # fmt: skip
    clipped = np.minimum(errors[held], record.clip)
    assert scores[0] == pytest.approx(np.sqrt(np.mean(clipped**2)), rel=1e-3)
    # The noise of a pixel is 0.7 px in x and in y.
    assert scores[-1] == pytest.approx(0.7 * np.sqrt(2), rel=0.1)


def test_tracks_of_two_images_hold_out_nothing_unless_asked(scene):
    truth, database = scene
    rank = np.arange(truth.num_observations) - np.searchsorted(
        truth.observation_point, truth.observation_point
    )
    start = truth.select(observations=rank < 2).problem
    result = bundle.refine_tracks(start, database)
    assert result.held_out is None
    assert result.problem.num_observations > 5 * start.num_observations
    with pytest.raises(bundle.InputError, match=r"^hold_out: "):
        bundle.refine_tracks(start, database, hold_out=10)


class Stop:
    """Progress function that interrupts a solve at its start, or raises an error."""

    def __init__(self, solve: int) -> None:
        self.solve, self.seen = solve, 0

    def __call__(self, iteration: dict[str, Any]) -> None:
        self.seen += iteration["iteration"] == 0
        if self.seen == self.solve:
            raise KeyboardInterrupt


@pytest.mark.parametrize("solve", [1, 2, 3])
def test_interrupts_leave_the_last_whole_round(scene, solve):
    truth, database = scene
    start = damaged(truth, "observations")
    whole = bundle.refine_tracks(start, database, hold_out=0, deterministic=True)
    result = bundle.refine_tracks(
        start, database, hold_out=0, deterministic=True, progress=Stop(solve)
    )
    assert result.summary.interrupted
    assert result.tracks == whole.tracks[: solve - 1]
    counts = [start.num_observations, *(one.num_observations for one in whole.tracks)]
    assert result.problem.num_observations == counts[solve - 1]
    check_model(result.problem, database)
    assert result.held_out is None


def test_interrupts_between_solves_leave_it_too(scene, monkeypatch):
    from bundle.model.pycolmap.tracks import TrackBuilder

    def interrupted(_: TrackBuilder) -> None:
        raise KeyboardInterrupt

    truth, database = scene
    monkeypatch.setattr(TrackBuilder, "extend", interrupted)
    result = bundle.refine_tracks(damaged(truth, "observations"), database)
    assert result.summary.interrupted
    assert len(result.tracks) == 1
    check_model(result.problem, database)


def test_interrupts_of_the_second_run_leave_the_first(scene, monkeypatch):
    truth, database = scene
    start = damaged(truth, "observations")
    whole = bundle.refine_tracks(start, database, hold_out=0, deterministic=True)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(chapter, "_predicted", interrupted)
    result = bundle.refine_tracks(start, database, deterministic=True)
    assert result.held_out is None
    assert not result.summary.interrupted
    assert result.tracks == whole.tracks
    np.testing.assert_array_equal(result.problem.points, whole.problem.points)


def test_an_unusable_adjustment_ends_the_rounds(scene, monkeypatch):
    truth, database = scene
    solve, count = solve_rounds.solve_prepared, [0]

    def unusable(*args: Any) -> bundle.Result:
        import dataclasses

        count[0] += 1
        result = solve(*args)
        summary = dataclasses.replace(result.summary, is_solution_usable=count[0] < 2)
        return dataclasses.replace(result, summary=summary)

    monkeypatch.setattr(solve_rounds, "solve_prepared", unusable)
    result = bundle.refine_tracks(damaged(truth, "observations"), database)
    assert not result.summary.is_solution_usable
    assert count == [2]


def test_positions_place_the_model_once(scene):
    truth, database = scene
    rng = np.random.default_rng(1)
    world = 7.0 * truth.projection_centers + [100.0, 200.0, 3.0]
    priors = [
        bundle.PositionPrior(name, xyz + rng.normal(0, 0.01, 3), (0.01, 0.01))
        for name, xyz in zip(truth.image_names, world, strict=True)
    ]
    start = damaged(truth, "observations")
    result = bundle.refine_tracks(start, database, priors=priors)
    assert result.similarity.scale == pytest.approx(7.0, rel=1e-3)
    assert [edit.edit for edit in result.edits] == ["alignment"]
    assert result.initial_problem is start
    assert np.linalg.norm(result.problem.projection_centers - world, axis=1).max() < 0.05
    assert result.held_out.clipped_rmse < result.tracks[0].held_out_rmse
    assert len(result.factor_costs_after) == len(priors)
    check_model(result.problem, database)


def test_control_points_are_no_tracks(scene):
    truth, database = scene
    targets = []
    for row in range(5):
        seen = truth.observation_point == row
        images = [truth.image_names[image] for image in truth.observation_image[seen]]
        pixels = truth.observation_xy[seen].tolist()
        targets.append(
            bundle.GroundControlPoint(
                name=f"t{row}",
                position=3.0 * truth.points[row],
                measurements=[(name, *xy) for name, xy in zip(images, pixels, strict=True)],
            )
        )
    result = bundle.refine_tracks(damaged(truth, "points"), database, priors=targets)
    assert len(result.control_points) == 5
    assert result.problem.num_points == truth.num_points
    assert max(np.abs(point.residual).max() for point in result.control_points) < 0.05
    check_model(result.problem, database)


def test_rules_refer_to_the_start_of_the_first_round(scene):
    truth, database = scene
    given = truth.camera_params[0, 0] * 1.01
    params = truth.camera_params.copy()
    params[0, 0] = given
    start = damaged(truth.replace(camera_params=params), "observations")
    rules = ["cameras *: f prior 0.01 %", "image 1: position fixed"]
    result = bundle.refine_tracks(start, database, constraints=rules, hold_out=0)
    (prior,) = result.constraints[0].priors
    assert prior.known == prior.before == (given,)
    assert len(result.tracks) > 2
    centre = start.projection_centers[0]
    np.testing.assert_allclose(result.problem.projection_centers[0], centre, atol=1e-9)


def test_later_rounds_have_the_place_and_the_rules_of_the_first(scene, monkeypatch):
    truth, database = scene
    requests, prepare = [], chapter.prepare

    def recorded(request: Any) -> Any:
        requests.append(request)
        return prepare(request)

    monkeypatch.setattr(chapter, "prepare", recorded)
    priors = [
        bundle.PositionPrior(name, 5.0 * xyz, (0.01, 0.01))
        for name, xyz in zip(truth.image_names, truth.projection_centers, strict=True)
    ]
    bundle.refine_tracks(
        damaged(truth, "observations"), database, priors=priors, hold_out=0,
        constraints=["cameras *: f prior 2 %"],
    )  # fmt: skip
    assert [one.align for one in requests] == [None] + [False] * (len(requests) - 1)
    assert [one.options.loss for one in requests[:2]] == ["soft_l1", "trivial"]
    (priors_of_rules,) = {one.constraints.priors for one in requests[1:]}
    assert [prior.parameter for prior in priors_of_rules] == ["f"]
    assert len({id(one.constraints) for one in requests[1:]}) == 1


def test_rigs_and_several_cameras_stay(tmp_path):
    truth = synthesize(tmp_path, num_rigs=2, num_cameras_per_rig=2, num_frames_per_rig=4)
    database = tmp_path / "database.db"
    start = damaged(truth, "split")
    result = bundle.refine_tracks(start, database, refine_sensor_from_rig=True)
    for name in ("camera_ids", "frame_ids", "image_frame", "image_sensor", "sensor_camera_ids"):
        np.testing.assert_array_equal(getattr(result.problem, name), getattr(start, name))
    assert result.problem.num_points == truth.num_points
    made = check_model(result.problem, database)
    assert (made.num_rigs(), made.num_frames()) == (2, 8)


def test_images_without_points_get_tracks_and_those_without_pose_stay(scene):
    truth, database = scene
    start = damaged(truth, "observations")
    start = start.select(observations=start.observation_image != 4).problem
    source = start.to_pycolmap()
    source.deregister_frame(source.image(9).frame_id)
    problem = bundle.Problem.from_pycolmap(source)
    assert problem.num_images == truth.num_images - 1
    result = bundle.refine_tracks(problem, database)
    assert (result.problem.observation_image == 4).sum() > 250
    made = check_model(result.problem, database)
    assert (made.num_images(), made.num_reg_images()) == (12, 11)


def test_ids_and_colours_stay(scene):
    """Ids of images and points differ from those of the database; merged points keep a colour."""
    truth, database = scene
    start = damaged(truth, "split")
    source = start.to_pycolmap()
    for point in source.points3D.values():
        point.color = np.array([10, 20, 30], np.uint8)
    problem = bundle.Problem.from_pycolmap(source)
    problem = problem.replace(image_ids=problem.image_ids + 50)
    result = bundle.refine_tracks(problem, database, hold_out=0)
    np.testing.assert_array_equal(result.problem.image_ids, problem.image_ids)
    assert result.problem.num_points < problem.num_points
    made = check_model(result.problem, database)
    merged = {key: point for key, point in made.points3D.items() if key > start.point_ids.max()}
    assert len(merged) > 100
    assert {tuple(point.color) for point in merged.values()} <= {(10, 20, 30), (0, 0, 0)}
    assert sum(tuple(point.color) == (10, 20, 30) for point in merged.values()) > 100


def test_models_of_other_formats_get_the_keypoints(scene, tmp_path):
    truth, database = scene
    start = damaged(truth, "observations")
    expected = bundle.refine_tracks(start, database, hold_out=0).problem
    bundle.save(start, tmp_path / "sfm", format="opensfm")
    problem = bundle.load(tmp_path / "sfm")
    result = bundle.refine_tracks(problem, database, hold_out=0)
    assert result.problem.num_observations == pytest.approx(expected.num_observations, abs=5)
    check_model(result.problem, database)


def test_a_reconstruction_is_not_changed(scene):
    truth, database = scene
    source = damaged(truth, "observations").to_pycolmap()
    count, before = source.compute_num_observations(), database.read_bytes()
    result = bundle.refine_tracks(source, database, hold_out=0)
    assert source.compute_num_observations() == count < result.problem.num_observations
    assert database.read_bytes() == before


REFUSALS = {
    "num_rounds": {"num_rounds": 1},
    "min_track_length": {"min_track_length": 1},
    "hold_out": {"hold_out": 80},
    "refine": {"refine": ("poses",)},
    "database": {"fixed_point_ids": (1,)},
    "max_error": {"max_error": 0},
}


@pytest.mark.parametrize("name", REFUSALS)
def test_refused_options_are_named(scene, name):
    truth, database = scene
    with pytest.raises(bundle.InputError, match=rf"^{name}: ") as caught:
        bundle.refine_tracks(damaged(truth, "observations"), database, **REFUSALS[name])
    assert "\n" not in str(caught.value)


def test_factors_of_points_are_refused(scene):
    truth, database = scene
    key = ("point", int(truth.point_ids[0]))
    factor = bundle.PriorFactor(key, truth.points[0], np.eye(3))
    with pytest.raises(bundle.InputError, match=f"found point {key[1]}$"):
        bundle.refine_tracks(truth, database, factors=[factor])
    image = bundle.PriorFactor(("image", 1), truth.cam_from_world[0], np.eye(6))
    assert bundle.refine_tracks(truth, database, factors=[image], hold_out=0).tracks


@pytest.mark.parametrize(
    "rule",
    [
        "points 4,7: position fixed",
        "points 4,7: position prior sigma 1",
        "points 4,7: on plane 0 0 1 0 sigma 9",
        "points 4-9: on plane sigma 9",
    ],
)
def test_rules_of_points_are_refused(scene, rule):
    truth, database = scene
    with pytest.raises(bundle.InputError, match=r"^constraints: [^\n]*found point 4$"):
        bundle.refine_tracks(truth, database, constraints=[rule], fixed_image_ids=(1, 2))


def test_problems_that_the_triangulator_would_bend_are_refused(scene):
    truth, database = scene
    sigmas = truth.replace(observation_sigma=np.ones(truth.num_observations))
    with pytest.raises(bundle.InputError, match="sigmas"):
        bundle.refine_tracks(sigmas, database)
