"""The fused backend takes the steps that Ceres takes, whatever it is asked for.

A covering design, so that every pair of values of two options occurs. Costs are compared to 1e-8
as far as Ceres agrees with itself: how much rounding matters to a problem is seen from its DENSE_QR
or, for inexact steps, from the same solver with the observations in another order.
"""

import collections
import functools

import numpy as np
import pytest

import bundle
from bundle.interface.options import LOSSES
from tests import scenes
from tests.solving.fused.covering import covering

SCENES = {
    "good": {},
    "bad start": {"perturbation": 6e-2},
    "short tracks": {"track": 4, "num_points": 120},
    "one point is behind": {},
}
KEPT = {
    "nothing": {},
    "two images": {"fixed_image_ids": (2, 4)},
    "a camera": {"fixed_camera_ids": (1,)},
    "points": {"fixed_point_ids": tuple(range(1, 13))},
    # Some observations have nothing to refine.
    "an image, its camera, points": {
        "fixed_image_ids": (1,),
        "fixed_camera_ids": (1,),
        "fixed_point_ids": tuple(range(5, 20)),
    },
    "intrinsics": {"refine": "poses,points"},
    "poses": {"refine": "points,focal,extra"},
    "nothing, principal points included": {
        "refine": "poses,points,focal,principal_point,extra",
    },
}
# Linear solver, preconditioner.
SOLVERS = {
    "dense": ("dense_schur", "auto"),
    "sparse": ("sparse_schur", "auto"),
    "iterative": ("iterative_schur", "schur_jacobi"),
    "iterative, jacobi": ("iterative_schur", "jacobi"),
    "iterative, identity": ("iterative_schur", "identity"),
}
FACTORS = {
    "scene": tuple(SCENES),
    "model": tuple(sorted(bundle.camera_models())),
    "shared": (False, True),
    "kept": tuple(KEPT),
    "loss": LOSSES,
    "gauge": ("none", "two_cameras", "three_points"),
    "cheirality": ("zero", "algebraic"),
    "solver": tuple(SOLVERS),
    "trust region": ("levenberg_marquardt", "dogleg", "subspace_dogleg"),
}


def allowed(row):
    exact = row["trust region"] == "levenberg_marquardt" or not row["solver"].startswith("iter")
    # A panorama has no intrinsics.
    something = not (row["model"] == "EQUIRECTANGULAR" and row["kept"] == "poses")
    return exact and something


ROWS = covering(FACTORS, allowed, seed=1)


def problem_of(row):
    changes = {"num_images": 6, "num_points": 70, "seed": 3, **SCENES[row["scene"]]}
    problem = scenes.make_problem(model=row["model"], shared=row["shared"], **changes)
    if row["scene"] == "one point is behind":
        points = problem.points.copy()
        points[7] = [0.3, 0.2, -9]
        return problem.replace(points=points)
    return problem


def options_of(row):
    solver, preconditioner = SOLVERS[row["solver"]]
    return {
        "linear_solver_type": solver,
        "preconditioner_type": preconditioner,
        "trust_region_strategy_type": row["trust region"],
        "loss": row["loss"],
        "loss_scale": 1.0 if row["loss"] == "trivial" else 5.0,
        "gauge": row["gauge"],
        "cheirality": row["cheirality"],
        "max_num_iterations": 25,
        "num_threads": 2,
        **KEPT[row["kept"]],
    }


def witnesses_of(row):
    """Return other solves by Ceres that would be the same one without rounding."""
    problem, options = problem_of(row), options_of(row)
    dense = [(problem, {**options, "linear_solver_type": "dense_qr"})]
    is_exact = options["linear_solver_type"] != "iterative_schur"
    return [(shuffled(problem), options), *(dense if is_exact else [])]


def shuffled(problem):
    order = np.random.default_rng(0).permutation(problem.num_observations)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    return problem.replace(**{name: getattr(problem, name)[order] for name in names})


@functools.cache
def traces(number):
    """A row by Ceres, by its witnesses and by the fused backend."""
    row = ROWS[number]
    problem, options = problem_of(row), options_of(row)
    return (
        bundle.solve(problem, backend="ceres", **options),
        [bundle.solve(one, backend="ceres", **same) for one, same in witnesses_of(row)],
        bundle.solve(problem, backend="fused", **options),
    )


def relative(found, expected):
    return np.abs(np.asarray(found) - expected) / np.maximum(np.abs(expected), 1e-300)


def num_comparable(number):
    """The number of iterations over which Ceres' own rounding stays below the tolerance."""
    expected, witnesses, _ = traces(number)
    costs, taken = expected.iterations["cost"], expected.iterations["step_is_successful"]
    counts = []
    for other in (one.iterations for one in witnesses):
        n = min(len(costs), len(other["cost"]))
        same = taken[:n] == other["step_is_successful"][:n]
        same &= relative(other["cost"][:n], costs[:n]) < 1e-9
        counts.append(n if same.all() else int(np.argmin(same)))
    return min(counts)


def is_comparable_to_the_end(number):
    return num_comparable(number) == len(traces(number)[0].iterations["cost"])


@pytest.mark.parametrize("number", range(len(ROWS)))
def test_same_steps(number):
    expected, _, found = traces(number)
    n = min(num_comparable(number), 11)  # the start and ten steps
    assert n > 0
    ours, theirs = found.iterations, expected.iterations
    assert ours["step_is_successful"][:n].tolist() == theirs["step_is_successful"][:n].tolist()
    # A rejected candidate may lie far out, where the cost amplifies the rounding of the step.
    off = np.abs(ours["cost"][:n] / theirs["cost"][:n] - 1)
    taken = np.asarray(theirs["step_is_successful"][:n], bool) | (np.arange(n) == 0)
    assert (off <= np.where(taken, 1e-8, 1e-6)).all(), off
    np.testing.assert_allclose(
        ours["trust_region_radius"][:n], theirs["trust_region_radius"][:n], rtol=1e-4
    )
    np.testing.assert_array_equal(
        ours["linear_solver_iterations"][: n - 1], theirs["linear_solver_iterations"][: n - 1]
    )
    assert found.summary.initial_cost == pytest.approx(expected.summary.initial_cost, rel=1e-12)
    assert found.summary.fixed_cost == pytest.approx(expected.summary.fixed_cost, rel=1e-12)
    if is_comparable_to_the_end(number):
        assert found.summary.termination_type == expected.summary.termination_type
        assert len(ours["cost"]) == len(theirs["cost"])
        assert found.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-9)
        assert found.summary.warnings == expected.summary.warnings


def test_the_summaries_count_the_same():
    names = [
        f"num_{what}{suffix}"
        for what in ("parameter_blocks", "parameters", "residual_blocks", "residuals")
        for suffix in ("", "_reduced")
    ]
    names += ["num_successful_steps", "num_unsuccessful_steps", "schur_structure_given"]
    names += ["trust_region_strategy_type", "dogleg_type", "num_threads_given", "num_threads_used"]
    names += ["preconditioner_type_given", "preconditioner_type_used", "linear_solver_type_used"]
    names += ["linear_solver_ordering_given", "linear_solver_ordering_used", "num_linear_solves"]
    for number in range(0, len(ROWS), 4):
        expected, _, found = traces(number)
        if not is_comparable_to_the_end(number):
            continue
        for name in names:
            assert getattr(found.summary, name) == getattr(expected.summary, name), (number, name)


def test_the_design_covers_what_it_says():
    seen = collections.Counter((name, value) for row in ROWS for name, value in row.items())
    assert all(seen[name, value] for name, values in FACTORS.items() for value in values)
    assert len(ROWS) < 250
    # Most of it can be compared to the end, and much of it has steps that are not taken.
    numbers = range(len(ROWS))
    assert sum(map(is_comparable_to_the_end, numbers)) > 0.7 * len(ROWS)
    assert sum(not traces(n)[0].iterations["step_is_successful"].all() for n in numbers) > 20
    assert sum(min(num_comparable(n), 11) for n in numbers) > 5 * len(ROWS)


def test_points_alone_are_for_ceres():
    problem = scenes.make_problem()
    refused = r"^refine: expected .* fused backend, found only points"
    with pytest.raises(bundle.InputError, match=refused):
        bundle.solve(problem, backend="fused", refine="points")
    summary = bundle.solve(problem, refine="points").summary
    assert (summary.backend_given, summary.backend_used) == ("AUTO", "CERES")
    assert summary.backend_choice.startswith("The fused backend expects")
    assert summary.backend_choice.endswith("(refine).")
