"""Runs that were killed and go on."""

import dataclasses
import json

import numpy as np
import pytest

import bundle
from bundle.solving.rounds import checkpoint
from bundle.solving.rounds import solve_rounds as rounds_of_solves
from bundle.solving.rounds.input_digest import digest, fingerprint_of_options
from tests.campaigns import resumes

OPTIONS = bundle.SolveOptions(
    loss="cauchy", deterministic=True, function_tolerance=1e-10, num_threads=1
)
ROUNDS = {"num_rounds": 4, "max_error": 1.2}


class KillError(Exception):
    """Stands for a kill."""


@pytest.fixture(scope="module")
def scene():
    return resumes.make_scene(60)


def equal(one, other):
    """Return whether two problems are the same, bit for bit."""
    return digest(one) == digest(other)


def reordered(problem):
    """Return a problem with its observations in the opposite order."""
    names = [f"observation_{name}" for name in ("image", "point", "xy", "keypoint")]
    return problem.replace(**{name: getattr(problem, name)[::-1] for name in names})


def renumbered(problem):
    """Return the same points with their ids and observations, the last one first."""
    return problem.replace(
        points=problem.points[::-1],
        point_ids=problem.point_ids[::-1],
        observation_point=problem.num_points - 1 - problem.observation_point,
    )


def kill_at(step):
    """Progress that stops a run at its n-th report."""
    count = iter(range(10**6))

    def progress(_):
        if next(count) == step:
            raise KillError

    return progress


def test_random_kills_change_nothing():
    outcome = resumes.campaign(12, seed=3, num_points=60)
    assert outcome.wrong == []
    assert outcome.kills >= 12
    assert outcome.with_checkpoint > 6


@pytest.mark.parametrize("more", [{}, {"only_images": "2-4"}, {"num_rounds": 0}])
def test_a_run_that_was_stopped_at_any_step_ends_the_same(scene, backend, tmp_path, more):
    settings = {**ROUNDS, "checkpoint_interval": 4, "backend": backend, **more}
    expected = bundle.solve_rounds(scene, OPTIONS, checkpoint=tmp_path / "whole", **settings)
    resumed = 0
    for step in range(3, 40, 9):
        path = tmp_path / f"run{step}"
        try:
            bundle.solve_rounds(scene, OPTIONS, checkpoint=path, progress=kill_at(step), **settings)
        except KillError:
            resumed += path.exists()
        result = bundle.solve_rounds(scene, OPTIONS, resume=path, **settings)
        assert equal(result.problem, expected.problem)
        assert result.rounds == expected.rounds
        assert result.summary.initial_cost == expected.summary.initial_cost
        assert result.summary.final_cost == expected.summary.final_cost
        assert result.summary.message == expected.summary.message
        np.testing.assert_array_equal(result.iterations["cost"], expected.iterations["cost"])
        np.testing.assert_array_equal(
            result.iterations["iteration"], np.arange(len(expected.iterations["iteration"]))
        )
    assert resumed >= 1


def test_a_run_that_has_ended_is_not_repeated(scene, tmp_path, monkeypatch):
    path = tmp_path / "run"
    expected = bundle.solve_rounds(scene, OPTIONS, checkpoint=path, **ROUNDS)
    monkeypatch.setattr(rounds_of_solves, "solve_prepared", lambda *_: pytest.fail("solved again"))
    result = bundle.solve_rounds(scene, OPTIONS, resume=path, **ROUNDS)
    assert equal(result.problem, expected.problem)
    assert result.summary == expected.summary
    assert result.rounds == expected.rounds
    assert result.initial_problem is scene


def test_a_file_that_does_not_exist_is_the_start(scene, tmp_path):
    path = tmp_path / "run"
    one = bundle.solve_rounds(scene, OPTIONS, resume=path, **ROUNDS)
    other = bundle.solve_rounds(scene, OPTIONS, checkpoint=tmp_path / "other", **ROUNDS)
    assert path.exists()
    assert equal(one.problem, other.problem)


def test_checkpoints_go_on_in_another_file(scene, tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    settings = {**ROUNDS, "checkpoint_interval": 2}
    with pytest.raises(KillError):
        bundle.solve_rounds(scene, OPTIONS, checkpoint=old, progress=kill_at(6), **settings)
    before = old.read_bytes()
    bundle.solve_rounds(scene, OPTIONS, checkpoint=new, resume=old, **settings)
    assert old.read_bytes() == before
    assert new.exists()


def test_within_one_segment_the_run_is_that_without_checkpoints(scene, tmp_path):
    plain = bundle.solve_rounds(scene, OPTIONS, **ROUNDS)
    kept = bundle.solve_rounds(
        scene, OPTIONS, checkpoint=tmp_path / "run", checkpoint_interval=1000, **ROUNDS
    )
    assert equal(plain.problem, kept.problem)


def test_segments_end_where_one_solve_ends(scene, backend):
    options = OPTIONS.replace(
        backend=backend, function_tolerance=1e-15, loss="trivial", gradient_tolerance=1e-12
    )
    one = bundle.solve(scene, options)
    saved, steps = [], []
    many = checkpoint.solve_in_segments(
        lambda problem, options, progress: bundle.solve(problem, options, progress=progress),
        scene, options, 3, save=saved.append, progress=lambda v: steps.append(v["iteration"]),
    )  # fmt: skip
    assert many.summary.final_cost == pytest.approx(one.summary.final_cost, rel=1e-9)
    assert many.summary.initial_cost == one.summary.initial_cost
    assert len(saved) in ((many.num_steps - 1) // 3, many.num_steps // 3)
    assert len(saved) > 2
    assert steps == list(range(many.num_steps + 1))
    cost = many.iterations["cost"]
    accepted = many.iterations["step_is_successful"].astype(bool)
    assert (np.diff(cost[accepted]) <= 0).all()
    summary = many.summary
    assert summary.num_successful_steps == accepted.sum()
    assert summary.num_unsuccessful_steps == (~accepted).sum()
    assert many.options.max_num_iterations == options.max_num_iterations
    assert (np.diff(many.iterations["cumulative_time_in_seconds"]) > 0).all()


def test_joined_segments_add_up_times_and_counts_that_were_measured(scene):
    one, other = (bundle.solve(scene, OPTIONS, max_num_iterations=2) for _ in range(2))
    unknown = dataclasses.replace(other.summary, preprocessor_time_in_seconds=-1.0)
    joined = checkpoint.join(one, other).summary
    for name in ("total_time_in_seconds", "minimizer_time_in_seconds", "num_linear_solves"):
        assert getattr(joined, name) == getattr(one.summary, name) + getattr(other.summary, name)
    partly = checkpoint.join(one, dataclasses.replace(other, summary=unknown)).summary
    assert partly.preprocessor_time_in_seconds == -1
    both = one.solve_time_in_seconds + other.solve_time_in_seconds
    assert checkpoint.join(one, other).solve_time_in_seconds == both


@pytest.mark.parametrize("limit", [0, 1, 4, 5])
def test_segments_keep_to_the_limit_of_iterations(scene, limit):
    options = OPTIONS.replace(max_num_iterations=limit, function_tolerance=0.0)
    result = checkpoint.solve_in_segments(
        lambda problem, options, progress: bundle.solve(problem, options, progress=progress),
        scene, options, 2, save=lambda _: None,
    )  # fmt: skip
    assert result.num_steps == limit
    assert result.summary.termination_type == "NO_CONVERGENCE"


def test_factors_and_bounds_belong_to_the_run(scene, tmp_path):
    path = tmp_path / "run"
    factors = [bundle.PositionFactor(("image", 1), scene.projection_centers[0], 1e4)]
    settings = {**ROUNDS, "checkpoint_interval": 2, "factors": factors}
    expected = bundle.solve_rounds(scene, OPTIONS, checkpoint=tmp_path / "whole", **settings)
    with pytest.raises(KillError):
        bundle.solve_rounds(scene, OPTIONS, checkpoint=path, progress=kill_at(6), **settings)
    with pytest.raises(bundle.InputError, match=r"^factors and bounds: "):
        bundle.solve_rounds(
            scene, OPTIONS, resume=path, **{**settings, "factors": [*factors, *factors]}
        )
    result = bundle.solve_rounds(scene, OPTIONS, resume=path, **settings)
    assert equal(result.problem, expected.problem)
    np.testing.assert_array_equal(result.factor_costs_before, expected.factor_costs_before)
    assert result.options == expected.options


@pytest.fixture
def stopped(scene, tmp_path):
    """The checkpoint of a run that was stopped."""
    with pytest.raises(KillError):
        bundle.solve_rounds(
            scene, OPTIONS, checkpoint=tmp_path / "run", checkpoint_interval=2,
            progress=kill_at(6), **ROUNDS,
        )  # fmt: skip
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"max_error": 1.3}, "max_error: expected 1.2 .* found 1.3"),
        ({"num_rounds": 5}, "num_rounds: "),
        ({"checkpoint_interval": 3}, "checkpoint_interval: "),
        ({"gauge": "none"}, 'gauge: expected "auto" .* found "none"'),
        ({"loss_scale": 2.0}, "loss_scale: "),
        ({"only_images": [1]}, "only_images: "),
        ({"fixed_image_ids": [1]}, "fixed_image_ids: "),
        ({"cheirality": "algebraic"}, "cheirality: "),
    ],
)
def test_other_options_are_refused(scene, stopped, changes, named):
    settings = {**ROUNDS, "checkpoint_interval": 2, **changes}
    before = stopped.read_bytes()
    with pytest.raises(bundle.InputError, match=rf"^{named}"):
        bundle.solve_rounds(scene, OPTIONS, resume=stopped, **settings)
    assert stopped.read_bytes() == before


def test_all_options_but_two_decide():
    decisive = fingerprint_of_options(OPTIONS)
    assert OPTIONS.asdict().keys() - decisive.keys() == {"num_threads", "check_solution"}


def test_another_number_of_threads_is_not(scene, stopped, tmp_path):
    settings = {**ROUNDS, "checkpoint_interval": 2}
    expected = bundle.solve_rounds(scene, OPTIONS, checkpoint=tmp_path / "whole", **settings)
    options = OPTIONS.replace(num_threads=2, check_solution=False)
    assert equal(
        bundle.solve_rounds(scene, options, resume=stopped, **settings).problem, expected.problem
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p.replace(observation_xy=p.observation_xy + 1e-9),
        lambda p: p.replace(image_names=["other.jpg", *p.image_names[1:]]),
        lambda p: p.replace(points=p.points * (1 + 1e-15)),
        lambda p: p.replace(point_ids=p.point_ids + 1),
        reordered,
        renumbered,
    ],
)
def test_another_input_is_refused(scene, stopped, change):
    with pytest.raises(bundle.InputError, match=r"^[^\n]*run: [^\n]* another input$"):
        bundle.solve_rounds(change(scene), OPTIONS, resume=stopped, checkpoint_interval=2, **ROUNDS)


def test_a_file_without_an_option_was_written_with_its_default(scene, stopped, tmp_path):
    """As a version wrote it that did not have the option."""
    with np.load(stopped) as archive:
        arrays = dict(archive)
    meta = json.loads(arrays["meta"].tobytes())
    del meta["fingerprint"]["initial_trust_region_radius"]
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    older = tmp_path / "older.npz"
    np.savez(older, **arrays)
    settings = {**ROUNDS, "checkpoint_interval": 2}
    expected = bundle.solve_rounds(scene, OPTIONS, resume=stopped, **settings)
    assert equal(
        bundle.solve_rounds(scene, OPTIONS, resume=older, **settings).problem, expected.problem
    )
    changed = OPTIONS.replace(initial_trust_region_radius=1e6)
    with pytest.raises(bundle.InputError, match=r"^initial_trust_region_radius: "):
        bundle.solve_rounds(scene, changed, resume=older, **settings)


def test_points_have_their_places_and_observations_none(scene):
    """Coordinates in a checkpoint go by index; a solve needs no order of what it sees."""
    assert digest(renumbered(scene)) != digest(scene)
    assert digest(reordered(scene)) == digest(scene)


@pytest.mark.parametrize("content", [b"PK", b"text", b"PK\x03\x04" + bytes(100), "cut", "npz"])
def test_what_is_no_checkpoint_is_refused_and_kept(scene, stopped, content):
    if content == "cut":
        content = stopped.read_bytes()[:-200]
    if content == "npz":
        np.savez(stopped.with_suffix(".npz"), a=np.zeros(3))
        content = stopped.with_suffix(".npz").read_bytes()
    stopped.write_bytes(content)
    for name in ("resume", "checkpoint"):
        with pytest.raises(bundle.InputError, match=r"^[^\n]*run: expected a checkpoint[^\n]*$"):
            bundle.solve_rounds(scene, OPTIONS, **{name: stopped}, **ROUNDS)
    assert stopped.read_bytes() == content


@pytest.fixture
def model(scene, tmp_path):
    bundle.save(scene, tmp_path / "model")
    return tmp_path / "model"


def test_the_command_goes_on(run, model, tmp_path):
    flags = ["--rounds", "4", "--max-error", "1.2", "--deterministic", "--checkpoint-interval", "2"]
    path, report = tmp_path / "run.ckpt", tmp_path / "report.json"
    code, _, err = run("refine", model, "-o", tmp_path / "a", "--quiet", *flags, "--resume", path)
    assert code == 0
    assert err.startswith("note: ")
    code, _, err = run(
        *("refine", model, "-o", tmp_path / "b", "--quiet", *flags, "--resume", path),
        *("--json", report),
    )
    assert (code, err) == (0, "")
    for file in (tmp_path / "a").iterdir():
        assert (tmp_path / "b" / file.name).read_bytes() == file.read_bytes()
    options = json.loads(report.read_text())["options"]
    assert (options["resume"], options["checkpoint_interval"]) == (str(path), 2)
    flags[3] = "1.5"
    code, _, err = run("refine", model, "-o", tmp_path / "c", "--quiet", *flags, "--resume", path)
    assert code == 2
    assert err.startswith("error: --max-error: expected 1.2")
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--checkpoint", "{out}"], "out"),
        (["--checkpoint", "{model}"], "model"),
        (["--checkpoint", "{model}/points3D.bin"], "points3D.bin"),
        (["--checkpoint", "{model}/cameras.bin/run"], "cameras.bin"),
        (["--checkpoint", ""], "--checkpoint"),
        (["--checkpoint", "run", "--checkpoint-interval", "0"], "--checkpoint-interval"),
        (["--checkpoint-interval", "3"], "--checkpoint-interval: valid only with --checkpoint"),
        (["--resume", "{model}"], "model"),
    ],
)
def test_bad_checkpoints_are_refused(run, model, tmp_path, monkeypatch, flags, named):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    given = [flag.format(model=model, out=out) for flag in flags]
    before = {file.name: file.read_bytes() for file in model.iterdir()}
    code, _, err = run("refine", model, "-o", out, "--quiet", *given)
    assert code == 2
    (line,) = err.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert not out.exists()
    assert {file.name: file.read_bytes() for file in model.iterdir()} == before
