"""Rounds of adjusting and filtering, against pycolmap's and against solving by hand."""

import json

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.solving.headline import headline
from bundle.solving.rounds import solve_rounds as rounds_of_solves
from tests.scenes import make_problem

TIGHT = {"function_tolerance": 1e-14, "gradient_tolerance": 1e-12, "parameter_tolerance": 1e-14}

# pycolmap 4.2: bundle adjustment with two cameras fixed, then filter_all_points3D(2, 1.5), until
# less than 0.05 % of the observations are filtered: (cost, observations filtered) of each round.
PYCOLMAP = {
    "crane_mast": [
        (5837.894924153, 1147), (1964.867490, 57), (1793.024026, 21), (1740.796263, 1),
    ],
    "bartoszek": [
        (3634.348422, 461), (1987.392202, 28), (1903.058477, 6), (1890.602786, 0),
    ],
}  # fmt: skip


def with_outliers(seed=0, num_points=80, share=0.05):
    """A scene in which some observations are far off."""
    problem = make_problem(
        num_images=8, num_points=num_points, model="PINHOLE", shared=True, noise=0.5, seed=seed
    )
    rng = np.random.default_rng(seed)
    wrong = rng.random(problem.num_observations) < share
    size = np.exp(rng.uniform(np.log(4), np.log(60), len(wrong)))
    side = rng.choice([-1, 1], (len(wrong), 2))
    xy = problem.observation_xy + (wrong * size)[:, None] * side
    return problem.replace(observation_xy=xy), wrong


@pytest.mark.parametrize("name", PYCOLMAP)
def test_rounds_are_those_of_pycolmap(bundle_data, backend, name):
    problem = bundle.load(bundle_data / "colmap" / name)
    result = bundle.solve_rounds(problem, max_error=2.0, backend=backend, **TIGHT)
    assert [done.num_observations_removed for done in result.rounds] == [
        count for _, count in PYCOLMAP[name]
    ]
    np.testing.assert_allclose(
        [done.cost for done in result.rounds], [cost for cost, _ in PYCOLMAP[name]], rtol=1e-9
    )
    last = result.rounds[-1]
    left = last.num_observations - last.num_observations_removed
    assert result.problem.num_observations == left
    assert result.problem.num_points == last.num_points - last.num_points_removed
    assert result.initial_problem is problem


def test_each_round_adjusts_what_the_one_before_has_left():
    problem, wrong = with_outliers()
    options = bundle.SolveOptions(loss="cauchy", backend="ceres", deterministic=True)
    result = bundle.solve_rounds(problem, options, num_rounds=3, max_error=1.2)
    current = problem
    for done in result.rounds:
        solved = bundle.solve(current, options)
        filtered = bundle.filter_observations(solved.problem, 1.2)
        assert done.cost == solved.summary.final_cost
        assert done.initial_cost == solved.summary.initial_cost
        assert (done.num_points, done.num_observations) == (
            current.num_points,
            current.num_observations,
        )
        assert done.num_observations_removed == filtered.num_observations_removed
        assert done.num_points_removed == filtered.num_points_removed
        assert (done.max_error, done.min_angle) == (1.2, 1.5)
        causes = ("beyond_max_error", "with_short_track", "below_min_angle")
        counts = [getattr(done, f"num_observations_{cause}") for cause in causes]
        assert counts == [getattr(filtered, f"num_observations_{cause}") for cause in causes]
        assert sum(counts) == done.num_observations_removed
        current = filtered.problem
    last = bundle.solve(current, options)
    np.testing.assert_array_equal(result.problem.points, last.problem.points)
    assert result.problem.num_observations == current.num_observations
    assert [done.round for done in result.rounds] == [1, 2, 3]
    assert result.problem.num_observations == pytest.approx((~wrong).sum(), rel=0.08)
    assert result.summary.final_cost == last.summary.final_cost
    assert result.summary.initial_cost == last.summary.initial_cost < result.rounds[-1].cost


def test_rounds_end_when_one_changes_next_to_nothing(monkeypatch):
    problem, _ = with_outliers()
    rounds = bundle.solve_rounds(problem, num_rounds=20, max_error=1.2, loss="cauchy").rounds
    shares = [done.num_observations_removed / done.num_observations for done in rounds]
    assert 2 < len(rounds) < 20
    assert shares[-1] < 5e-4 <= min(shares[:-1])
    monkeypatch.setattr(rounds_of_solves, "SMALLEST_CHANGE", 1.0)
    assert (
        len(bundle.solve_rounds(problem, num_rounds=20, max_error=1.2, loss="cauchy").rounds) == 1
    )


@pytest.mark.parametrize("num_rounds", [1, 2, 5])
@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
def test_rounds_end_at_a_minimum(backend, num_rounds, loss):
    problem, _ = with_outliers()
    options = bundle.SolveOptions(loss=loss, backend=backend, **TIGHT)
    result = bundle.solve_rounds(problem, options, num_rounds=num_rounds, max_error=1.5)
    assert len(result.rounds) <= num_rounds and result.rounds[0].num_observations_removed > 0
    again = bundle.solve(result.problem, options)
    assert again.summary.initial_cost == pytest.approx(result.summary.final_cost, rel=1e-12)
    assert again.summary.final_cost == pytest.approx(result.summary.final_cost, rel=1e-9)
    left = problem.num_observations - sum(r.num_observations_removed for r in result.rounds)
    assert result.problem.num_observations == left


def test_a_filter_that_removes_nothing_is_not_followed(monkeypatch):
    problem, _ = with_outliers(share=0)
    solves = []
    solve = rounds_of_solves.solve_prepared
    monkeypatch.setattr(
        rounds_of_solves, "solve_prepared", lambda *a: solves.append(1) or solve(*a)
    )
    result = bundle.solve_rounds(problem, num_rounds=3, max_error=100.0, min_angle=0.0)
    assert len(result.rounds) == len(solves) == 1


def test_no_rounds_are_a_solve():
    problem, _ = with_outliers()
    result = bundle.solve_rounds(problem, num_rounds=0, deterministic=True)
    expected = bundle.solve(problem, deterministic=True)
    assert result.rounds == ()
    np.testing.assert_array_equal(result.problem.points, expected.problem.points)
    assert result.problem.num_observations == problem.num_observations


def test_points_that_are_known_stay():
    problem, _ = with_outliers(share=0.1)
    plain = bundle.solve_rounds(problem, max_error=2.0, min_track_length=4)
    gone = np.setdiff1d(problem.point_ids, plain.problem.point_ids)
    held, measured = int(gone[0]), int(gone[1])
    factor = bundle.PriorFactor(("point", measured), problem.points[measured - 1], 1e6 * np.eye(3))
    result = bundle.solve_rounds(
        problem,
        max_error=2.0,
        min_track_length=4,
        fixed_point_ids=[held],
        factors=[factor],
        gauge="two_cameras",
    )
    assert {held, measured} <= set(result.problem.point_ids.tolist())
    assert len(result.problem.point_ids) < problem.num_points
    where = result.problem.point_ids == held
    np.testing.assert_array_equal(result.problem.points[where][0], problem.points[held - 1])


def test_an_adjustment_without_a_solution_is_not_filtered():
    problem, _ = with_outliers()

    def stop(values):
        if values["iteration"] == 1:
            raise KeyboardInterrupt

    result = bundle.solve_rounds(problem, progress=stop)
    assert result.summary.interrupted
    assert result.rounds == ()
    assert result.problem.num_observations == problem.num_observations


def test_a_filter_that_leaves_nothing_is_refused():
    problem, _ = with_outliers()
    with pytest.raises(bundle.InputError, match=r"^num_rounds: [^\n]*\b640\b[^\n]*max_error=1e-09"):
        bundle.solve_rounds(problem, max_error=1e-9)


@pytest.fixture
def colmap_model(tmp_path):
    problem, _ = with_outliers()
    bundle.save(problem, tmp_path / "model")
    return tmp_path / "model"


def test_the_command_reports_each_round(run, colmap_model, tmp_path):
    report = tmp_path / "report.json"
    limits = ["--max-error", "3", "--min-angle", "2", "--min-track", "3"]
    limits += ["--json", report, "--verbose"]
    code, out, _ = run("refine", colmap_model, "-o", tmp_path / "out", "--rounds", "3", *limits)
    assert code == 0
    found = json.loads(report.read_text())
    expected = bundle.solve_rounds(
        colmap_model, num_rounds=3, max_error=3, min_angle=2, min_track_length=3
    )
    assert len(found["rounds"]) == len(expected.rounds)
    for done, reference in zip(found["rounds"], expected.rounds, strict=True):
        assert done["round"] == reference.round
        assert done["cost"] == pytest.approx(reference.cost, rel=1e-6)
        assert done["num_observations"] == reference.num_observations
        assert done["num_observations_removed"] == reference.num_observations_removed
        assert done["num_points_removed"] == reference.num_points_removed
        assert str(reference.num_observations) in out
    options = found["options"]
    assert [options[name] for name in ("num_rounds", "max_error", "min_angle")] == [3, 3.0, 2.0]
    assert options["min_track_length"] == 3
    model = pycolmap.Reconstruction(tmp_path / "out")
    assert model.compute_num_observations() == expected.problem.num_observations
    assert found["reprojection_error"]["after"]["max"] <= 3.0
    linked = sum(image.num_points3D for image in model.images.values())
    assert linked == model.compute_num_observations()


def test_without_rounds_nothing_is_told_of_them(run, colmap_model, tmp_path):
    report = tmp_path / "report.json"
    run("refine", colmap_model, "-o", tmp_path / "out", "--json", report)
    found = json.loads(report.read_text())
    assert "rounds" not in found
    assert "num_rounds" not in found["options"]


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--rounds", "-1"], "--rounds"),
        (["--rounds", "two"], "--rounds"),
        (["--rounds", "2", "--max-error", "0"], "--max-error"),
        (["--rounds", "2", "--min-angle", "91"], "--min-angle"),
        (["--rounds", "2", "--min-track", "1.5"], "--min-track"),
        (["--max-error", "3"], "--max-error: valid only with --rounds"),
        (["--min-angle", "3"], "--min-angle: valid only with --rounds"),
        (["--min-track", "3"], "--min-track: valid only with --rounds"),
        (["--rounds", "2", "--max-error", "1e-9"], "--max-error 1e-09"),
    ],
)
def test_bad_flags_are_refused(run, colmap_model, tmp_path, flags, named):
    code, out, err = run("refine", colmap_model, "-o", tmp_path / "out", "--quiet", *flags)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert not (tmp_path / "out").exists()


def test_the_headline_tells_what_each_limit_deletes():
    problem, _ = with_outliers()
    limits = {"max_error": 1.2, "min_angle": 60.0, "min_track_length": 7}
    result = bundle.solve_rounds(problem, num_rounds=1, loss="cauchy", **limits)
    (done,) = result.rounds
    first = bundle.solve(problem, loss="cauchy").problem
    errors, _ = bundle.reprojection_errors(first)
    kept = errors <= 1.2
    track = np.bincount(first.observation_point[kept], minlength=first.num_points)
    rays = first.points[:, None] - first.projection_centers[None]
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    counts = [int((~kept).sum()), 0, 0]
    for point in range(first.num_points):
        seen = first.observation_image[kept & (first.observation_point == point)]
        cosine = np.abs(rays[point, seen] @ rays[point, seen].T).min(initial=1.0)
        if track[point] < 7:
            counts[1] += int(track[point])
        elif np.degrees(np.arccos(cosine)) < 60.0:
            counts[2] += int(track[point])
    names = ("beyond_max_error", "with_short_track", "below_min_angle")
    assert [getattr(done, f"num_observations_{name}") for name in names] == counts
    assert min(counts) > 0
    told = f"({counts[0]:,} above 1.2 px, {counts[2]:,} of points below 60 degrees, "
    (sentence,) = [one for one in headline(result) if one.startswith("Deleted ")]
    assert f"{told}{counts[1]:,} of short tracks): this alone" in sentence
    wide = bundle.solve_rounds(problem, num_rounds=1, min_angle=0, max_error=1.2, loss="cauchy")
    assert "degrees" not in headline(wide)[1]
