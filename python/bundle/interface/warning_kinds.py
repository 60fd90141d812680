"""Kinds of a solve's warnings, as named in ``Summary.warning_kinds`` and in JSON.

Sentences are for people and may change; these names do not change.
"""

from __future__ import annotations

__all__ = ["WARNING_KINDS"]

WARNING_KINDS = {
    "gauge_not_held": "the problem has too little to hold the gauge that was asked for",
    "gauge_beside_factors": "the gauge is held although factors say where the world is",
    "points_seen_once": "free points with one observation have no depth of their own",
    "far_origin": "the scene is far from its origin and was solved about its centre",
    "far_points": "points lie more than 1000 times the size of the scene away",
    "far_points_dominate": "far points bent the solution to fit them: not usable",
    "single_thread": "Ceres ran on one thread, to be deterministic or for a function in Python",
    "preconditioner_not_used": "a direct solver has no use for the preconditioner",
    "ordering_not_used": "the linear solver has no use for the elimination ordering",
    "ordering_replaced": "nothing of the ordering's first group is refined: Ceres chose its own",
    "solver_replaced": "Ceres used another linear solver than it was given",
    "preconditioner_replaced": "Ceres used another preconditioner than it was given",
    "factor_larger_than_predicted": "the factor has more than 1.5 times the predicted entries",
    "residual_not_finite": "a squared residual is infinite at the start",
    "suspicious_steps": "the iterations look like those of a wrong Jacobian",
    "suspicious_jacobian": "analytic derivatives differ from differences at the end",
    "invalid_solution": "the solution is no reconstruction and was discarded",
    "observations_behind": "more observations are behind their cameras than at the start",
    "too_many_behind": "more than 1 % of the observations went behind: not usable",
    "observations_left_out": "observations that were behind before are in front at the end",
    "no_projection": "no observation has a projection: not usable",
    "steep_end": "steps became too short although the model still predicts a decrease",
    "formula_jump": "omega of FOV met the jump of COLMAP's formula at 0.01",
    "world_scale": "the unit of length is far from the size of the scene, and factors keep it",
    "weak_baseline": "focal lengths and baselines of rigs changed together, which is weak",
    "several_components": "no edge or factor joins parts of a graph: each floats by itself",
    "local_minimum": "a pose graph converged above the cost of another start",
    "better_start": "a pose graph did not converge and ended above the cost of another start",
    "unproven_set": "a larger consistent set of closures may exist: the search ran out of time",
    "one_process": "processes of mpirun waited while one solved what cannot be divided",
    "wrong_factor": "the Jacobian of a factor in Python differs from differences",
    "free_directions": "no factor determines some directions: the damping alone holds them",
    "prior_spectrum": "the information of a marginalised prior has an alarming spectrum",
    "most_left_out": "half of the closures or more contradict the largest consistent set",
}
"""Each kind with its meaning."""
