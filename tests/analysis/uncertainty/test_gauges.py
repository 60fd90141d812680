"""Gauges beside inner constraints, and active bounds, against the dense form without columns."""

import dataclasses

import numpy as np
import pytest

import bundle
from tests.analysis.uncertainty.random_problems import random_case
from tests.analysis.uncertainty.test_covariance import compare


def with_bound(case, rng):
    """A focal length on a bound, which holds it if the cost falls beyond."""
    problem = case.problem
    camera = int(rng.integers(problem.num_cameras))
    column = case.dense.column["camera", camera, 0]
    gradient = case.dense.jacobian[:, column] @ case.dense.residual
    width = len(bundle.camera_models()[problem.camera_models[camera]])
    low, high = np.full(width, -np.inf), np.full(width, np.inf)
    is_upper = rng.random() < 0.5
    (high if is_upper else low)[0] = problem.camera_params[camera, 0]
    bounds = {("camera", int(problem.camera_ids[camera])): (low, high)}
    is_held = gradient < 0 if is_upper else gradient > 0
    basis = case.basis[:, case.basis[column] == 0] if is_held else case.basis
    return dataclasses.replace(case, settings={**case.settings, "bounds": bounds}, basis=basis)


def held_by_gauge(case, cov):
    """Columns of the dense form that are free in its basis, but have no covariance."""
    held = np.zeros(len(case.dense.names), bool)
    for kind, values in (
        ("image", cov.pose_covariance),
        ("frame", cov.frame_covariance),
        ("point", cov.point_covariance),
    ):
        for i, block in enumerate(values):
            first = case.dense.column.get((kind, i, 0))
            if first is not None:
                held[first : first + len(block)] = np.diag(block) == 0
    return held & case.basis.any(axis=1)


def without_bounded(cov):
    """Parameters on a bound have variance 0; the dense form holds them, which is nan."""
    cameras = cov.camera_covariance.copy()
    for values in cameras:
        held = np.diag(values) == 0
        values[held] = values[:, held] = np.nan
    return dataclasses.replace(cov, camera_covariance=cameras)


@pytest.mark.parametrize("robust", ["weights", "sandwich"])
@pytest.mark.parametrize("gauge", ["inner", "two_cameras", "three_points"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_gauges_and_bounds_are_those_of_the_dense_form(seed, gauge, robust):
    case = random_case(seed)
    if "constraints" not in case.settings:
        case = with_bound(case, np.random.default_rng(seed))
    if robust == "sandwich" and case.joins_points:
        with pytest.raises(bundle.InputError, match="robust: expected weights"):
            bundle.covariance(case.problem, robust=robust, factors=case.factors, **case.settings)
        return
    if robust == "sandwich" and case.settings["loss"] not in ("trivial", "soft_l1"):
        pytest.skip("off a minimum only a convex loss is sure to have a sandwich")
    cov = bundle.covariance(
        case.problem, gauge=gauge, robust=robust, factors=case.factors, **case.settings
    )
    if gauge != "inner":
        held = held_by_gauge(case, cov)
        case = dataclasses.replace(case, basis=case.basis[:, ~case.basis[held].any(axis=0)])
    bent = {"sandwich": robust == "sandwich", "num_priors": case.num_prior_rows}
    dense = case.dense.covariance(case.basis, **bent)
    assert max(compare(case, dense, without_bounded(cov)).values()) < 1e-9
