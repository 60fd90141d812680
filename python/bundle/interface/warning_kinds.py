"""Kinds of a solve's warnings and their meanings, as in ``Summary.warning_kinds`` and in JSON.

Sentences are for people and may change; these names do not change.
"""

from __future__ import annotations

__all__ = ["WARNING_KINDS"]

WARNING_KINDS = {
    "gauge_not_held": "the requested gauge could not be fixed",
    "gauge_beside_factors": "the gauge is fixed although factors determine the world",
    "points_seen_once": "the depth of free points with one observation is undetermined",
    "far_origin": "the scene is far from its origin and was solved about its centre",
    "far_points": "points lie more than 1000 times the size of the scene away",
    "far_points_dominate": "the solution mainly fits far points: not usable",
    "single_thread": "Ceres ran on one thread, to be deterministic or for a function in Python",
    "preconditioner_not_used": "a direct solver does not use the preconditioner",
    "ordering_not_used": "the linear solver does not use the elimination ordering",
    "ordering_replaced": "the first group of the ordering is not refined: Ceres chose its own",
    "solver_replaced": "Ceres replaced the requested linear solver",
    "preconditioner_replaced": "Ceres replaced the requested preconditioner",
    "factor_larger_than_predicted": "the factor has more than 1.5 times the predicted entries",
    "residual_not_finite": "a squared residual is infinite at the start",
    "suspicious_steps": "the iterations look like those of a wrong Jacobian",
    "suspicious_jacobian": "analytic derivatives differ from finite differences at the end",
    "invalid_solution": "the solution is invalid and was discarded",
    "observations_behind": "more observations are behind their cameras than at the start",
    "too_many_behind": "more than 1 % of the observations moved behind their cameras: not usable",
    "observations_left_out": "observations moved from behind their cameras to the front",
    "no_projection": "no observation has a projection: not usable",
    "steep_end": "steps became too short although the model still predicts a decrease",
    "formula_jump": "omega of FOV reached 0.01, where COLMAP's formula jumps",
    "world_scale": "the size of the scene is extreme, and factors fix the unit of length",
    "readout_outside": "a readout ended outside of 0 to 1 frame: it is not determined",
    "weak_baseline": "focal lengths and baselines of rigs changed together: hardly separable",
    "several_components": "no edge or factor connects parts of a graph: their relation is free",
    "local_minimum": "a pose graph converged above the cost of another start",
    "better_start": "a pose graph did not converge and ended above the cost of another start",
    "unproven_set": "a larger consistent set of closures may exist: the search ran out of time",
    "one_process": "one process solved while others waited: the solve cannot be divided",
    "wrong_factor": "the Jacobian of a factor in Python differs from finite differences",
    "free_directions": "no factor determines some directions: only the damping limits them",
    "prior_spectrum": "the prior's information is asymmetric, indefinite or ill-conditioned",
    "no_tracks": "no point is seen twice, so that nothing relates the images: not usable",
    "ordering": "another elimination order needs less than half of the flops",
    "most_left_out": "half of the closures or more contradict the largest consistent set",
}
"""Each kind with its meaning."""
