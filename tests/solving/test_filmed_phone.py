"""Rolling shutters on a film with reference costs, readouts and twists by independent code."""

import csv
import json

import numpy as np
import pytest

import bundle

PIXEL_SIGMA = 0.5
"""Sigma of the references' residuals in pixels; costs here have a sigma of one pixel."""

READOUT = 0.8
TIED = {"twists": "tied", "twist_sigma": (0.004 * READOUT / PIXEL_SIGMA,) * 2}
CASES = {
    "gs": ("global", {}),
    "gs_priors": ("global", {"priors"}),
    "free_observed_row": ("observed", {}),
    "free_fixed_point": ("fixed-point", {}),
    "free_fixed_point_priors": ("fixed-point", {"priors"}),
    "soft_priors_fixed_point_known_rho": ("fixed-point", {"priors", "tied"}),
    "soft_priors_observed_row_known_rho": ("observed", {"priors", "tied"}),
    "hard_observed_row": ("observed", {"hard"}),
    "hard_observed_row_rho": ("observed", {"hard", "readout"}),
    "hard_fixed_point": ("fixed-point", {"hard"}),
    "hard_fixed_point_rho": ("fixed-point", {"hard", "readout"}),
    "mtie_priors_fixed_point_rho": ("fixed-point", {"priors", "tied", "readout"}),
}


@pytest.fixture(scope="module")
def phone(bundle_data):
    folder = bundle_data / "rolling_shutter" / "phone"
    problem = bundle.load(folder / "model")
    place = {int(image): k for k, image in enumerate(problem.image_ids)}
    frames, neighbours = np.zeros(problem.num_images), np.zeros((problem.num_images, 2), int)
    with (folder / "frames.csv").open() as file:
        for row in csv.DictReader(file):
            k = place[int(row["image_id"])]
            frames[k] = float(row["frame"])
            neighbours[k] = [place[int(row[f"neighbour_{which}"])] for which in "ab"]
    with (folder / "positions.csv").open() as file:
        priors = [
            bundle.PositionPrior(
                row["name"], [float(row[c]) for c in "xyz"], float(row["sigma"]) / PIXEL_SIGMA
            )
            for row in csv.DictReader(file)
        ]
    expected = json.loads((folder / "expected.json").read_text())["results"]
    return problem, frames, neighbours, priors, expected


# Of Ceres each row time and each part once or more.
OF_CERES = (
    *("gs_priors", "free_observed_row", "hard_fixed_point_rho"),
    *("soft_priors_observed_row_known_rho", "mtie_priors_fixed_point_rho"),
)


@pytest.mark.parametrize(
    ("name", "backend"),
    [*((name, "fused") for name in CASES), *((name, "ceres") for name in OF_CERES)],
)
def test_costs_readouts_and_twists_are_those_of_the_references(phone, name, backend):
    problem, frames, neighbours, priors, expected = phone
    row_time, parts = CASES[name]
    given = {}
    if row_time != "global":
        problem = problem.replace(
            rolling_shutter=bundle.RollingShutter(
                direction=("rows",) * problem.num_cameras,
                readout=[0.5 if "readout" in parts else READOUT] * problem.num_cameras,
                twist=np.zeros((problem.num_images, 6)),
                frames=frames,
                neighbours=neighbours,
                row_time=row_time,
            )
        )
    if "priors" in parts:
        given |= {"priors": priors, "align": False}
    given |= TIED if "tied" in parts else {"twists": "hard"} if "hard" in parts else {}
    given |= {"refine_readout": True} if "readout" in parts else {}
    solved = bundle.solve(
        problem, backend=backend, refine=("poses", "points"), max_num_iterations=300,
        function_tolerance=1e-15, gradient_tolerance=1e-13, parameter_tolerance=1e-14, **given,
    )  # fmt: skip
    wanted = expected[name]
    assert solved.summary.final_cost / PIXEL_SIGMA**2 == pytest.approx(wanted["cost"], rel=1e-10)
    found = solved.problem.rolling_shutter
    if found is None:
        return
    assert found.readout[0] == pytest.approx(wanted["readout"] or READOUT, abs=1e-6)
    twists = READOUT * np.array(wanted["twists"])
    if "readout" in parts:
        twists *= wanted["readout"] / READOUT
    known = 6 if "priors" in parts else 3  # without positions the scale is free
    np.testing.assert_allclose(found.twist[:, :known], twists[:, :known], atol=1e-6)
