"""One request: whoever runs it starts from the same preparation and takes the same steps."""

import pickle
import pickletools
from pathlib import Path

import numpy as np
import pytest

import bundle
from bundle.interface.round_options import RoundOptions
from bundle.model.estimates import VARIABLES
from bundle.solving import prepare as preparation
from bundle.solving.executors import solve_prepared
from bundle.solving.prepare import prepare
from bundle.solving.ranks import divided_solve
from bundle.solving.request import PartRequest, SolveRequest
from bundle.solving.rounds.plan import RunPlan
from bundle.solving.rounds.solve_rounds import run
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem, scene
from tests.solving.ranks.thread_crew import processes

OPTIONS = bundle.SolveOptions(
    backend="fused", deterministic=True, num_threads=1, max_num_iterations=6
)
VALUES = tuple(one.name for one in VARIABLES if not one.holder)


def position(problem, row, weight=1e3):
    place = problem.projection_centers[row] + 0.1
    return bundle.PositionFactor(("image", int(problem.image_ids[row])), place, weight)


def requests():
    """Return requests of all kinds that have no priors and no part."""
    plain, rigs = make_problem(num_images=5, num_points=50), rig_problem(num_alone=2)
    params = plain.camera_params[0]
    return {
        "plain": {"problem": plain},
        "factors": {"problem": plain, "factors": (position(plain, 1), position(plain, 3))},
        "bounds": {"problem": plain, "bounds": {("camera", 1): (params - 1, params + 1)}},
        "rules": {
            "problem": plain,
            "constraints": bundle.Constraints(
                "cameras *: share f", "camera 1: k prior 0 sigma 0.01"
            ),
        },
        "rigs": {"problem": rigs, "constraints": ("cameras *: f prior 2 %",)},
    }


KINDS = requests()


def assert_equal_values(one, other):
    for name in VALUES:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def assert_same(one, other):
    assert_equal_values(one.problem, other.problem)
    np.testing.assert_array_equal(one.iterations["cost"], other.iterations["cost"])
    for name in ("factor_costs_before", "factor_costs_after"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.active_bounds == other.active_bounds
    assert one.summary.warning_kinds == other.summary.warning_kinds
    assert one.options == other.options


@pytest.mark.parametrize("kind", KINDS)
def test_all_who_run_a_request_take_the_same_steps(kind):
    request = SolveRequest(**KINDS[kind], options=OPTIONS)
    given = {**KINDS[kind], "options": OPTIONS}
    expected = bundle.solve(**given)
    assert len(expected.iterations["cost"]) > 2
    others = [
        run(request, RunPlan()),
        run(request, RunPlan()),  # which leaves the request as it was
        bundle.solve_rounds(**given, num_rounds=0),
        prepare(request).finished(solve_prepared(prepare(request), None)),
    ]
    for result in others:
        assert_same(result, expected)
        assert result.constraints == expected.constraints
        assert result.initial_problem is given["problem"]
    solver = bundle.Solver(**given)
    for result in (solver.solve(), solver.solve()):
        assert_same(result, expected)
    with processes(2):
        divided = bundle.solve(**given)
        of_solver = solver.solve()
    assert set(of_solver.summary.warning_kinds) - set(expected.summary.warning_kinds) == {
        "one_process"
    }
    for name in VALUES:
        np.testing.assert_array_equal(
            getattr(divided.problem, name), getattr(expected.problem, name)
        )


def with_priors():
    problem = scene(num_images=6).replace(image_names=[f"{k}.jpg" for k in range(6)])
    places = 2 * problem.projection_centers + 5
    names = problem.image_names
    return problem, [
        bundle.PositionPrior(*one, (0.1, 0.2)) for one in zip(names, places, strict=True)
    ]


def test_priors_move_a_problem_once():
    problem, priors = with_priors()
    request = SolveRequest(problem=problem, options=OPTIONS, priors=tuple(priors))
    expected, result = bundle.solve(problem, OPTIONS, priors=priors), run(request, RunPlan())
    assert_same(result, expected)
    assert result.similarity.scale == expected.similarity.scale == pytest.approx(2, rel=0.05)
    prepared = prepare(request)
    assert prepared.placed.similarity.scale == result.similarity.scale
    assert prepared.request.problem is problem
    assert len(prepared.factors) == len(priors)


@pytest.fixture
def prepared(monkeypatch):
    """Count what is prepared and laid out."""
    counts = {"place_at_priors": 0, "lay_out": 0}

    def counted(name):
        function = getattr(preparation, name)

        def call(*arguments, **more):
            counts[name] += 1
            return function(*arguments, **more)

        monkeypatch.setattr(preparation, name, call)

    for name in counts:
        counted(name)
    return counts


@pytest.mark.parametrize(
    "function",
    [bundle.solve, bundle.solve_rounds, bundle.covariance, bundle.diagnose, bundle.Solver],
)
def test_every_solve_is_prepared_once_and_in_one_place(prepared, function):
    more = {"num_rounds": 0} if function is bundle.solve_rounds else {}
    problem = KINDS["plain"]["problem"]
    function(problem, max_num_iterations=1, **more)
    assert prepared == {"place_at_priors": 1, "lay_out": 1}


def test_rounds_are_placed_once_and_laid_out_for_each_adjustment(prepared):
    problem, priors = with_priors()
    result = bundle.solve_rounds(problem, OPTIONS, priors=priors, num_rounds=2, max_error=1.0)
    again = result.rounds[-1].num_observations_removed > 0
    assert len(result.rounds) + again > 1
    assert prepared == {"place_at_priors": 1, "lay_out": len(result.rounds) + again}


def test_a_solver_lays_out_once(prepared):
    problem = KINDS["plain"]["problem"]
    solver = bundle.Solver(problem, OPTIONS, factors=KINDS["factors"]["factors"])
    for _ in range(3):
        solver.solve(problem.replace(points=problem.points + 1e-3), max_num_iterations=1)
    assert prepared == {"place_at_priors": 1, "lay_out": 1}


BAD = {
    "align": {"align": 3},
    "priors": {"priors": [3]},
    "constraints": {"constraints": ["camera 99: f fixed"]},
    "factors": {"factors": [3]},
    "bounds": {"bounds": {("camera", 99): (0, 1)}},
    "fixed_image_ids": {"fixed_image_ids": [99]},
}
"""Arguments that are refused, in the order of the checks."""


@pytest.mark.parametrize("function", [bundle.solve, bundle.solve_rounds, bundle.diagnose])
@pytest.mark.parametrize("first", range(len(BAD) - 1))
def test_the_first_of_two_errors_is_that_of_the_earlier_check(function, first):
    names = list(BAD)
    for second in names[first + 1 :]:
        with pytest.raises(bundle.InputError, match=rf"^(\w+: )?{names[first]}|^{names[first]}"):
            function(KINDS["plain"]["problem"], **BAD[names[first]], **BAD[second])


@pytest.mark.parametrize(
    ("earlier", "later", "words"),
    [
        ({"num_rounds": -1}, {"rest": "no"}, "num_rounds: "),
        ({"rest": "no"}, {"checkpoint_interval": 0}, "rest: "),
        ({"checkpoint_interval": 0}, {"checkpoint": 3}, "checkpoint_interval: "),
        ({"checkpoint": 3}, {"resume": 3}, "checkpoint: "),
        ({"resume": 3}, {"align": True, "only_images": [99]}, "resume: "),
        ({"align": True, "only_images": [1]}, {"priors": [3]}, "align: "),
        ({"only_images": [99]}, {"constraints": ["camera 99: f fixed"]}, "only_images: "),
        ({"constraints": ["camera 99: f fixed"]}, {"checkpoint": "/dev/null/x"}, "constraints"),
        ({"checkpoint": "/dev/null/x"}, {"factors": [3]}, "/dev/null/x: "),
        ({"checkpoint": "/dev/null/x"}, {"bounds": {("camera", 99): (0, 1)}}, "/dev/null/x: "),
    ],
)
def test_rounds_check_their_limits_and_files_before_factors(earlier, later, words):
    given = {"num_rounds": 1, **later, **earlier}
    with pytest.raises(bundle.InputError, match=f"^{words}"):
        bundle.solve_rounds(KINDS["plain"]["problem"], **given)


def test_segments_and_rounds_warn_once(tmp_path):
    """The result warns of the last adjustment only, not of each segment and each round."""
    problem = make_problem(num_images=5, num_points=50)
    with processes(2):
        result = bundle.solve_rounds(
            problem, num_rounds=2, checkpoint=tmp_path / "run", checkpoint_interval=1,
            backend="ceres", num_threads=1, max_num_iterations=3,
        )  # fmt: skip
    assert len(result.iterations["cost"]) > 2
    assert list(result.summary.warning_kinds).count("one_process") == 1
    assert len(result.summary.warnings) == len(result.summary.warning_kinds)


def modules_of(pickled):
    found = (str(argument).split(" ")[0] for _, argument, _ in pickletools.genops(pickled))
    return {name for name in found if name.startswith("bundle.")}


def test_no_pickle_holds_what_was_prepared():
    problem, priors = with_priors()
    found = bundle.covariance(
        problem, of="poses", priors=priors, constraints=["images *: rotation prior sigma 5"]
    )
    modules = modules_of(pickle.dumps(found))
    assert "bundle.solving.request" in modules
    assert not [name for name in modules if name.startswith("bundle.solving.prepare")]
    again = pickle.loads(pickle.dumps(found))
    ids = problem.image_ids[:2].tolist()
    np.testing.assert_array_equal(again.relative(*ids), found.relative(*ids))


def test_jobs_of_processes_hold_no_rules(monkeypatch):
    jobs = []
    work_on = divided_solve.work_on
    monkeypatch.setattr(
        divided_solve, "work_on", lambda job, *a: jobs.append(job) or work_on(job, *a)
    )
    with processes(2):
        bundle.solve(**KINDS["rules"], options=OPTIONS)
    (job,) = jobs
    assert job.restrictions is not None
    assert not [name for name in modules_of(pickle.dumps(job)) if ".constraints.rule" in name]


def test_a_solver_never_moves_its_world():
    problem, _ = with_priors()
    solver = bundle.Solver(problem, OPTIONS, factors=[position(problem, 0)])
    assert solver.problem is problem
    assert solver.solve().similarity is None
    with pytest.raises(bundle.InputError, match="no option 'priors'"):
        bundle.Solver(problem, priors=[])


def test_requests_are_data():
    problem = KINDS["plain"]["problem"]
    factors = KINDS["factors"]["factors"]
    request = SolveRequest(problem=problem, factors=iter(factors), priors=iter(()))
    assert request.factors == factors
    assert request.priors == ()
    again = pickle.loads(pickle.dumps(SolveRequest(problem=problem, factors=factors)))
    assert [factor.key for factor in again.factors] == [factor.key for factor in factors]
    with pytest.raises(AttributeError):
        request.problem = problem
    for name in ("factors", "priors"):
        with pytest.raises(bundle.InputError, match=f"^{name}: expected a list"):
            SolveRequest(problem=problem, **{name: 3})


def test_plans_and_parts():
    assert RunPlan().file is None
    assert RunPlan(resume="a").file == Path("a")
    plan = RunPlan(checkpoint="b", resume="a", rounds=RoundOptions(num_rounds=2))
    assert (plan.file, plan.resume, plan.checkpoint_interval) == (Path("b"), Path("a"), 20)
    with pytest.raises(bundle.InputError, match=r"^checkpoint_interval: "):
        RunPlan(checkpoint_interval=0)
    assert PartRequest.of(None, "fixed") is None
    assert PartRequest.of([1], "MARGINAL") == PartRequest([1], "marginal")
    for images, rest in ((None, "marginal"), ([1], "free")):
        with pytest.raises(bundle.InputError, match=r"^rest: "):
            PartRequest.of(images, rest)


def test_a_part_is_the_whole_where_all_images_are_named():
    problem = KINDS["plain"]["problem"]
    part = PartRequest(problem.image_ids.tolist())
    held = OPTIONS.replace(fixed_image_ids=tuple(problem.image_ids[:2].tolist()))
    whole = run(SolveRequest(problem=problem, options=held), RunPlan())
    of_part = run(SolveRequest(problem=problem, options=held, part=part), RunPlan())
    assert prepare(SolveRequest(problem=problem, part=part)).start is problem
    assert_equal_values(of_part.problem, whole.problem)
    assert of_part.part.num_images_held == 0


def test_rigs_with_frames_and_sensors_outside_of_the_part():
    problem = rig_problem(num_frames=6, rigs=(STEREO, STEREO), num_alone=1)
    part = PartRequest(problem.image_ids[:4].tolist())
    result = run(SolveRequest(problem=problem, options=OPTIONS, part=part), RunPlan())
    named = result.problem.cam_from_world != problem.cam_from_world
    assert set(np.flatnonzero(named.any(axis=1))) <= set(range(4))
    moved = (result.problem.rig_from_world != problem.rig_from_world).any(axis=1)
    assert 0 < moved.sum() <= 2
    np.testing.assert_array_equal(result.problem.sensor_from_rig, problem.sensor_from_rig)


@pytest.mark.parametrize(("images", "gauge"), [(1, "none"), (5, "auto")])
def test_a_marginal_rest_takes_the_gauge_where_there_is_one(images, gauge):
    problem = KINDS["plain"]["problem"]
    part = PartRequest(problem.image_ids[:images].tolist(), "marginal")
    prepared = prepare(SolveRequest(problem=problem, part=part))
    assert prepared.rest.holds_gauge == (gauge == "none")
    assert prepared.options.gauge == gauge


def test_a_result_of_a_part_has_the_options_that_were_asked_for():
    problem = KINDS["plain"]["problem"]
    held = {
        "fixed_image_ids": (int(problem.image_ids[1]),),
        "fixed_camera_ids": (int(problem.camera_ids[0]),),
        "fixed_point_ids": (int(problem.point_ids[3]),),
    }
    part = PartRequest(problem.image_ids[:3].tolist())
    result = run(
        SolveRequest(problem=problem, options=OPTIONS.replace(**held), part=part), RunPlan()
    )
    assert {name: getattr(result.options, name) for name in held} == held
    rules = (f"points {problem.point_ids[0]}-{problem.point_ids[1]}: position fixed",)
    request = SolveRequest(problem=problem, options=OPTIONS, part=part, constraints=rules)
    assert run(request, RunPlan()).options.fixed_point_ids == ()
