"""Bundle Adjustment in the Large: the costs that every solver must reach."""

import pytest

import bundle

# 1/2 sum r^2 at start and minimum, everything free but the principal point. The minimum was found
# by Ceres' own example and by pycolmap on the converted problem.
REFERENCE = {
    "problem-16-22106-pre": (4.185659518e6, 1.803390348e4, (22106, 16)),
    "problem-21-11315-pre": (4.413239314e6, 3.037863580e4, (11315, 21)),
}
# The stopping rule that it takes for seven digits.
CONVERGED = {"function_tolerance": 1e-10, "max_num_iterations": 200}


# Every two of backend, solver and problem.
CASES = [
    ("problem-16-22106-pre", "ceres", "sparse_schur"),
    ("problem-16-22106-pre", "fused", "dense_schur"),
    ("problem-16-22106-pre", "fused", "iterative_schur"),
    ("problem-21-11315-pre", "ceres", "dense_schur"),
    ("problem-21-11315-pre", "ceres", "iterative_schur"),
    ("problem-21-11315-pre", "fused", "sparse_schur"),
]


@pytest.mark.parametrize(("name", "backend", "solver"), CASES)
def test_schur_solvers_reach_the_reference_cost(bundle_data, name, backend, solver):
    problem = bundle.load(bundle_data / "bal" / f"{name}.txt.bz2")
    initial_cost, final_cost, ordering = REFERENCE[name]
    summary = bundle.solve(problem, backend=backend, linear_solver_type=solver, **CONVERGED).summary
    assert summary.initial_cost == pytest.approx(initial_cost, rel=1e-9)
    assert summary.final_cost == pytest.approx(final_cost, rel=1e-7)
    assert summary.linear_solver_ordering_given == ordering
    assert summary.linear_solver_ordering_used == ordering
    assert summary.linear_solver_type_used == summary.linear_solver_type_given == solver.upper()
    assert summary.schur_structure_used == "2,3,9"
    assert summary.warnings == ()


@pytest.mark.parametrize(
    ("cheirality", "cost"), [("algebraic", 8.509124607e5), ("zero", 8.508020903e5)]
)
def test_observations_behind_the_camera(solve, bundle_data, cheirality, cost):
    problem = bundle.load(bundle_data / "bal" / "problem-49-7776-pre.txt.bz2")
    result = solve(problem, cheirality=cheirality, max_num_iterations=0)
    assert result.summary.initial_cost == pytest.approx(cost, rel=1e-9)
    assert result.reprojection_error_before.num_behind_camera == 31
