"""Validations that no solver made, for reports and pages."""

import numpy as np

from bundle.judging.validation.row_test import RowTest
from bundle.judging.validation.validation_result import (
    DecisionRule,
    ValidatedCandidate,
    Validation,
    decide,
    verdict_of,
)
from tests.scenes import make_problem

LENSES = (
    ("SIMPLE_RADIAL", "size", 2, 1.08, "", ""),
    ("OPENCV", "size", 6, 1.0, "", ""),
    ("SIMPLE_RADIAL", "each", 40, 1.07, "motion", ""),
    ("OPENCV", "each", 120, 0.94, "motion", ""),
    ("FOV", "all", 2, np.nan, "", "camera 1: expected <b>one</b> size"),
)


def row_tested(fires):
    """Return a row test that fires or not."""
    return RowTest(
        fires=fires, is_suspected=True, isotropy=2.0, anisotropy=8.5, shear=9.25, size=0.05,
        deviations=np.ones(3), sigma=0.5, confirmation=9.0, images=np.arange(20),
        slopes=np.zeros((20, 3)), errors=np.ones((20, 3)), gain=0.1,
    )  # fmt: skip


def validation(lenses=LENSES, fires=True, source="garden/sparse/0"):
    """Return a validation of 20 images with a camera each."""
    rng, problem = np.random.default_rng(0), make_problem(num_images=20, num_points=30)
    image = np.repeat(np.arange(20), 40)
    noise = rng.rayleigh(1.0, len(image))
    errors = np.array([level * noise * (1 + 0.004 * rng.random()) for *_, level, _, _ in lenses])
    free = [one[2] for one in lenses]
    vetoes = [one[4] if fires else "" for one in lenses]
    rule = DecisionRule()
    decision = decide(errors, image, free, vetoes, rule)
    rmse = np.sqrt(np.mean(np.minimum(0.5 * errors, 4.0) ** 2, axis=1))
    records = tuple(
        ValidatedCandidate(
            camera_model=model, share=share, loss="cauchy", refine=("poses", "focal", "extra"),
            num_cameras=20 if share == "each" else 1, num_intrinsics=count,
            num_parameters=3000 + count, fitted_rmse=0.9 * level, fitted_median=0.5,
            fitted_clipped_rmse=0.85 * level, held_out_rmse=float(rmse[k]),
            held_out_median=0.6, share_clipped=0.01, num_without_projection=0,
            score=float(decision.scores[k]), difference=float(decision.differences[k]),
            standard_error=float(decision.standard_errors[k]), aic=10.0 * k, bic=5.0 * k,
            position_sigma=0.01 * (1 + k), check_points_rms=np.nan, gps_rms=np.nan,
            is_converged=True, num_iterations=60, vetoed=vetoes[k], error=error,
            command=f"bundle refine {source} -o OUTPUT --loss cauchy --camera-model {model}",
        )
        for k, (model, share, count, level, _, error) in enumerate(lenses)
    )  # fmt: skip
    test = row_tested(fires)
    found = verdict_of(records, decision, test, problem)
    return problem, Validation(
        candidates=records, recommended=decision.recommended, best=decision.best,
        present=found.present, verdict=found.verdict, headline=found.headline,
        command=records[decision.recommended].command, num_folds=5, seed=0, clip=4.0, sigma=0.5,
        row_test=test, rule=rule, decision=decision, observations=np.arange(len(image)),
        image=image, errors=0.5 * errors, normalized=errors, notes=found.notes,
        time_in_seconds=12.5,
    )  # fmt: skip
