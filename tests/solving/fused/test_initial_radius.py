"""The trust region radius of the first step: by both backends, on ranks, in rounds and segments."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.interface.options import TRUST_REGION_STRATEGIES
from bundle.solving.rounds import checkpoint
from tests import scenes
from tests.campaigns import resumes
from tests.rig_scenes import rig_problem
from tests.solving.ranks.thread_crew import alone_and_divided
from tests.solving.solve import levenberg_marquardt
from tests.solving.solve.lies import SCENES

RADII = [1e-2, 1e2, 1e6, 1e16]
NAME = "initial_trust_region_radius"


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("strategy", TRUST_REGION_STRATEGIES)
def test_both_backends_start_with_it(strategy, radius):
    problem = scenes.make_problem(perturbation=0.03)
    options = {
        "trust_region_strategy_type": strategy,
        NAME: radius,
        "max_num_iterations": 6,
        "gauge": "two_cameras",  # without damping, a free gauge would only add rounding errors
    }
    ours, ceres = (
        bundle.solve(problem, backend=backend, **options).iterations
        for backend in ("fused", "ceres")
    )
    for iterations in (ours, ceres):
        assert iterations["trust_region_radius"][0] == radius
    np.testing.assert_allclose(ours["cost"], ceres["cost"], rtol=1e-7)
    np.testing.assert_allclose(ours["trust_region_radius"], ceres["trust_region_radius"], rtol=1e-4)


@pytest.mark.parametrize("radius", RADII[:3])
def test_the_damping_is_its_reciprocal(solve, radius):
    """The replica damps dense normal equations by D^2 / radius."""
    changes, columns = SCENES["shared camera"]
    problem = scenes.make_problem(**changes)
    options = {NAME: radius, "max_num_iterations": 5}
    trace = levenberg_marquardt.solve(problem, columns=columns, **options).iterations
    rules = {"gauge": "none", "cheirality": "algebraic", "convergence": "ceres"}
    found = solve(problem, **rules, **options).iterations
    for name in ("cost", "trust_region_radius"):
        expected = [step[name] for step in trace]
        np.testing.assert_allclose(found[name], expected, rtol=1e-5)


@pytest.mark.parametrize("strategy", TRUST_REGION_STRATEGIES)
def test_a_larger_radius_takes_a_longer_first_step(solve, strategy):
    problem = scenes.make_problem(perturbation=0.03)
    lengths = [
        solve(
            problem,
            max_num_iterations=1,
            trust_region_strategy_type=strategy,
            **{NAME: radius},
        ).iterations["step_norm"][1]
        for radius in (1e-3, 1e-1, 1e1, 1e4)
    ]
    assert (np.diff(lengths) > 0).all()


def test_its_effect_does_not_depend_on_the_unit_of_length(solve):
    problem = scenes.make_problem(perturbation=0.03)
    larger = problem.cam_from_world.copy()
    larger[:, 4:] *= 8
    scaled = problem.replace(points=8 * problem.points, cam_from_world=larger)
    traces = [
        solve(one, max_num_iterations=4, **{NAME: 1e2}).iterations["cost"]
        for one in (problem, scaled)
    ]
    np.testing.assert_allclose(*traces, rtol=1e-6)  # the Jacobi scaling is 1 / (1 + norm)


def test_ranks_start_with_it():
    alone, divided = alone_and_divided(rig_problem(num_frames=4), 3, **{NAME: 1e6})
    assert alone.iterations["trust_region_radius"][0] == 1e6
    np.testing.assert_allclose(divided.iterations["cost"], alone.iterations["cost"], rtol=1e-9)
    np.testing.assert_allclose(
        divided.iterations["trust_region_radius"], alone.iterations["trust_region_radius"]
    )


def test_a_graph_starts_with_it_unless_its_steps_are_undamped():
    graph = bundle.FactorGraph()
    graph.add_variable("a", [3.0, 4.0])
    graph.add_factor(bundle.PriorFactor("a", [0.0, 0.0], 1.0))
    found = graph.solve(**{NAME: 1e-2}, max_num_iterations=1)
    assert found.iterations["trust_region_radius"][0] == 1e-2
    # D^2 is the curvature 1 here, so that a step is 1 / (1 + 1 / radius) of the way.
    np.testing.assert_allclose(found.values["a"], np.array([3.0, 4.0]) * (1 - 1 / 101), rtol=1e-9)
    with pytest.raises(bundle.InputError, match=f"^{NAME}: "):
        graph.solve(trust_region_strategy_type="gauss_newton", **{NAME: 1e-2})


def test_each_round_starts_anew(backend):
    starts = []

    def note(record):
        if record["iteration"] == 0:
            starts.append(record["trust_region_radius"])

    bundle.solve_rounds(
        resumes.make_scene(60),
        backend=backend,
        num_rounds=2,
        max_error=1.2,
        progress=note,
        **{NAME: 3e5},
    )
    assert starts == [3e5, 3e5]


@pytest.mark.parametrize("strategy", TRUST_REGION_STRATEGIES)
@pytest.mark.parametrize("interval", [1, 2])
def test_segments_keep_the_radius_and_the_steps(solve, interval, strategy):
    """Segments take the steps of one solve, up to the scaling of the columns."""
    problem = scenes.make_problem(perturbation=0.03)
    options = bundle.SolveOptions(
        trust_region_strategy_type=strategy, gauge="two_cameras", **{NAME: 1e2}
    )
    one = solve(problem, options)
    many = checkpoint.solve_in_segments(
        lambda problem, options, progress: solve(problem, options, progress=progress),
        problem,
        options,
        interval,
        save=lambda _: None,
    )
    np.testing.assert_allclose(many.iterations["cost"], one.iterations["cost"], rtol=1e-3)
    np.testing.assert_allclose(
        many.iterations["trust_region_radius"], one.iterations["trust_region_radius"], rtol=1e-2
    )
    assert getattr(many.options, NAME) == 1e2
    assert many.options.max_num_iterations == options.max_num_iterations


def test_a_dogleg_beyond_the_largest_radius_goes_on():
    problem = scenes.make_problem()
    first = bundle.solve(problem, max_num_iterations=1)
    radius = first.iterations["trust_region_radius"]
    wide = dataclasses.replace(
        first, iterations={**first.iterations, "trust_region_radius": 1e20 * radius}
    )
    goes_on = checkpoint.solve_in_segments(
        lambda problem, options, progress: bundle.solve(problem, options, progress=progress),
        first.problem,
        bundle.SolveOptions(),
        50,
        so_far=wide,
        save=lambda _: None,
    )
    assert goes_on.summary.termination_type == "CONVERGENCE"
