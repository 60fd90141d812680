"""Degrees of freedom beside gravity, orientations and headings: dense Jacobians, three counts."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, HeadingPrior, OrientationPrior, PositionPrior
from bundle.solving.request import place_at_priors
from tests.rig_scenes import STEREO
from tests.solving.test_gauge_freedom import mono, nullity, options, rigs, two_halves

ALL = range(5)
UP = (0.0, -1.0, 0.0)
"""Upper edge of the image."""

# Problem, what is measured or fixed, degrees of freedom. "noisy": degrees of noise.
CASES = {
    "gravity of one image": (mono(), {"gravity": (2,)}, 5),
    "gravity of all images": (mono(), {"gravity": ALL}, 5),
    "noisy gravity": (mono(), {"gravity": ALL, "noisy": 20}, 5),
    "gravity and a heading": (mono(), {"gravity": ALL, "heading": (1,)}, 4),
    "one heading": (mono(), {"heading": (1,)}, 6),
    "two headings": (mono(), {"heading": (1, 3)}, 5),
    "one orientation": (mono(), {"orientation": (4,)}, 4),
    "all orientations": (mono(), {"orientation": ALL, "noisy": 10}, 4),
    "orientations and gravity": (mono(), {"orientation": (0, 1), "gravity": ALL}, 4),
    "gravity and one position": (mono(), {"gravity": (0, 3), "priors": (2,)}, 2),
    "gravity and two positions": (mono(), {"gravity": (0, 3), "priors": (1, 2)}, 0),
    "gravity, heading, one position": (
        mono(), {"gravity": ALL, "heading": (2,), "priors": (2,)}, 1),
    "gravity, heading, two positions": (
        mono(), {"gravity": ALL, "heading": (2,), "priors": (2, 0)}, 0),
    "orientation and one position": (mono(), {"orientation": (1,), "priors": (2,)}, 1),
    "gravity and three positions": (mono(), {"gravity": ALL, "priors": (0, 1, 2)}, 0),
    "gravity and a fixed image": (mono(), {"gravity": ALL, "fixed": (0,)}, 1),
    "gravity of the fixed image": (mono(), {"gravity": (0,), "fixed": (0,)}, 1),
    "gravity and a fixed point": (mono(), {"gravity": ALL, "points": (3,)}, 2),
    "gravity and two fixed points": (mono(), {"gravity": ALL, "points": (3, 5)}, 0),
    "gravity and a focal length": (mono(shared=True), {"gravity": ALL, "focal": True}, 5),
    "rig, gravity": (rigs(STEREO), {"gravity": ALL}, 4),
    "rig, gravity of a sensor": (rigs(STEREO), {"gravity": (1,)}, 4),
    "rig, orientation": (rigs(STEREO), {"orientation": (1,)}, 3),
    "rig, gravity and a position": (rigs(STEREO), {"gravity": (1,), "priors": (2,)}, 1),
    "refined rig, gravity": (rigs(STEREO), {"gravity": ALL, "arms": True}, 5),
    "refined rig, orientations": (rigs(STEREO), {"orientation": (0, 1), "arms": True}, 4),
    "rig, gravity and a fixed frame": (rigs(STEREO), {"gravity": ALL, "fixed": (2,)}, 0),
    "two pieces, gravity of one": (
        two_halves(rigs(STEREO, num_points=32)), {"gravity": (0,)}, 10),
}  # fmt: skip


def disturbed(rng, degrees):
    return Rotation.from_rotvec(np.radians(degrees) * rng.standard_normal(3))


def priors_of(problem, what):
    rng = np.random.default_rng(5)
    noise, made = what.get("noisy", 0), []
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4])
    for i in what.get("gravity", ()):
        down = (disturbed(rng, noise) * rotations[i]).apply([0, 0, -1])
        made.append(GravityPrior(int(problem.image_ids[i]), 9.81 * down, 0.5))
    for i in what.get("orientation", ()):
        turned = (disturbed(rng, noise) * rotations[i]).as_quat()
        made.append(OrientationPrior(int(problem.image_ids[i]), turned, (3, 1)))
    for i in what.get("heading", ()):
        east, north, _ = rotations[i].inv().apply(UP)
        heading = np.degrees(np.arctan2(east, north))
        made.append(HeadingPrior(int(problem.image_ids[i]), heading, 2, axis=UP))
    made += [
        PositionPrior(int(problem.image_ids[i]), problem.projection_centers[i], 0.01)
        for i in what.get("priors", ())
    ]
    return made


def local_rows(problem, what):
    """Derivatives of the residuals by left perturbations: R' = Exp(phi) R."""
    rows = []
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()

    def skew(v):
        return np.cross(np.eye(3), v)  # [v]x

    for i in what.get("gravity", ()):
        by_turn = -skew(rotations[i] @ [0, 0, -1.0])
        rows.append((i, np.hstack([by_turn, np.zeros((3, 3))])))
    for i in what.get("orientation", ()):
        rows.append((i, np.hstack([np.eye(3), np.zeros((3, 3))])))
    for i in what.get("heading", ()):
        axis = np.array(UP)
        y = rotations[i].T @ axis
        by_turn = rotations[i].T @ skew(axis)
        slope = np.array([y[1], -y[0], 0]) / (y[0] ** 2 + y[1] ** 2)
        rows.append((i, np.hstack([slope @ by_turn, np.zeros(3)])[None]))
    return rows


@pytest.mark.parametrize("case", CASES)
def test_counts_are_nullities(case):
    problem, what, degrees = CASES[case]
    made = priors_of(problem, what)
    placed = place_at_priors(problem, (), tuple(made), None).problem
    known = {name: what[name] for name in ("fixed", "points", "arms", "focal", "priors")
             if name in what}  # fmt: skip
    assert nullity(placed, **known, attitudes=local_rows(placed, what)) == degrees
    settings = options(problem, what)
    assert bundle.gauge_freedom(problem, settings, priors=made).degrees == degrees
    found = bundle.diagnose(problem, settings, priors=made)
    assert found.nullity == degrees
    if "pieces" not in case:  # the gauge is that of one world
        assert found.expected_nullity == degrees


@pytest.mark.parametrize("case", [case for case, row in CASES.items() if "pieces" not in case])
def test_covariances_lose_these_degrees(case):
    problem, what, degrees = CASES[case]
    made = priors_of(problem, what)
    placed = place_at_priors(problem, (), tuple(made), None).problem
    found = bundle.covariance(placed, options(problem, what), priors=made, of="poses")
    sizes = {"gravity": 2, "orientation": 3, "heading": 1, "priors": 3}
    rows = sum(size * len(what.get(name, ())) for name, size in sizes.items())
    free = (problem.num_frames or problem.num_images) - len(what.get("fixed", ()))
    free += problem.num_sensors * bool(what.get("arms"))
    columns = 6 * free + 3 * (problem.num_points - len(what.get("points", ())))
    columns += 2 * bool(what.get("focal"))  # fx, fy
    assert found.dof == 2 * problem.num_observations + rows - (columns - degrees)
