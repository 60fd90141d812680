"""A graph of every manifold and factor against differences of the same residuals over matrices."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import bundle

EYE = [0.0, 0, 0, 1]
INFORMATION = np.array([[4.0, 1, 0], [1, 3, 0.5], [0, 0.5, 2]])


def hat(w):
    return np.cross(np.eye(3), w)


# Values as matrices, moved by expm of the Lie algebra on the right.
def se3(value):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(value[:4]).as_matrix()
    matrix[:3, 3] = value[4:]
    return matrix


def exp_se3(d):
    algebra = np.zeros((4, 4))
    algebra[:3, :3], algebra[:3, 3] = hat(d[:3]), d[3:]
    return expm(algebra)


def log_se3(matrix):
    algebra = logm(matrix).real
    return np.array([algebra[2, 1], algebra[0, 2], algebra[1, 0], *algebra[:3, 3]])


def se2(value):
    c, s = np.cos(value[2]), np.sin(value[2])
    return np.array([[c, -s, value[0]], [s, c, value[1]], [0, 0, 1]])


def exp_se2(d):
    return expm(np.array([[0, -d[2], d[0]], [d[2], 0, d[1]], [0, 0, 0]]))


def log_se2(matrix):
    algebra = logm(matrix).real
    return np.array([algebra[0, 2], algebra[1, 2], algebra[1, 0]])


START = {
    "camera": ("euclidean", [500.0, 320, 240], 3),
    "pose": ("se3", [0.1, -0.05, 0.02, 0.99, 0.1, -0.2, 4], 6),
    "next": ("se3", [0.1, 0.15, 0.02, 0.98, -0.9, -0.1, 4.2], 6),
    "point": ("euclidean", [0.3, -0.2, 0.5], 3),
    "turn": ("so3", [0.3, -0.1, 0.2, 0.92], 3),
    "heading": ("so2", [0.7], 1),
    "place": ("se2", [1.0, 2.0, 0.6], 3),
}
KEYS = list(START)
STEP = np.array([0.2, -0.1, 0.3, 0.9, 1, 0.2, -0.1])
SEEN = {"pose": [350.0, 205], "next": [236.0, 210]}


def aligned(values):
    """The heading is the angle of the place, and the turn's third angle twice that."""
    heading, place = values
    return [3 * (heading[0] - place[2]), heading[0] ** 2 - place[0]], [
        [[3.0], [2 * heading[0]]],
        # By the x and y in the frame of the place, and its angle.
        [[0, 0, -3], [-np.cos(place[2]), np.sin(place[2]), 0]],
    ]


def graph():
    made = bundle.FactorGraph()
    for key, (manifold, value, _) in START.items():
        made.add_variable(key, value, manifold)
    for factor in (
        bundle.PriorFactor("camera", [510, 318, 243], 0.01),
        bundle.PriorFactor("pose", [0, 0, 0, 1, 0, 0, 4.1], np.diag([1.0, 2, 3, 4, 5, 6])),
        bundle.BetweenFactor("pose", "next", STEP, 2.0),
        bundle.ReprojectionFactor("pose", "camera", "point", SEEN["pose"], "SIMPLE_PINHOLE", 0.04),
        bundle.ReprojectionFactor("next", "camera", "point", SEEN["next"], "SIMPLE_PINHOLE", 0.04),
        bundle.PositionFactor("next", [1, 0.3, -4], INFORMATION, lever_arm=[0.2, 0.1, -0.3]),
        bundle.PriorFactor("turn", EYE, INFORMATION),
        bundle.PriorFactor("point", [0.2, 0.1, 0.4], INFORMATION),
        bundle.PriorFactor("place", [1.5, 1.8, 0.9], INFORMATION),
        bundle.FunctionFactor(["heading", "place"], aligned),
    ):
        made.add_factor(factor)
    return made


def residuals(given, delta):
    """The same, from matrices, of values that are moved by tangent coordinates."""
    values, first = {}, 0
    for key, (manifold, _, size) in START.items():
        start = given[key]
        d = delta[first : first + size]
        first += size
        start = np.array(start, float)
        if manifold == "se3":
            start[:4] /= np.linalg.norm(start[:4])
            values[key] = se3(start) @ exp_se3(d)
        elif manifold == "so3":
            values[key] = Rotation.from_quat(start).as_matrix() @ expm(hat(d))
        elif manifold == "se2":
            values[key] = se2(start) @ exp_se2(d)
        else:
            values[key] = start + d
    root = np.linalg.cholesky(INFORMATION).T
    camera, point = values["camera"], values["point"]
    rows = [0.1 * (camera - [510, 318, 243])]
    error = log_se3(np.linalg.inv(se3([0, 0, 0, 1, 0, 0, 4.1])) @ values["pose"])
    rows.append(np.sqrt([1.0, 2, 3, 4, 5, 6]) * error)
    step = np.linalg.inv(values["pose"]) @ values["next"]
    rows.append(
        np.sqrt(2)
        * log_se3(np.linalg.inv(se3(STEP / [*[np.linalg.norm(STEP[:4])] * 4, 1, 1, 1])) @ step)
    )
    for key, seen in SEEN.items():
        x, y, z = values[key][:3, :3] @ point + values[key][:3, 3]
        rows.append(0.2 * (camera[0] * np.array([x, y]) / z + camera[1:] - seen))
    r, t = values["next"][:3, :3], values["next"][:3, 3]
    rows.append(root @ (r.T @ ([0.2, 0.1, -0.3] - t) - [1, 0.3, -4]))
    rows.append(root @ Rotation.from_matrix(values["turn"]).as_rotvec())
    rows.append(root @ (point - [0.2, 0.1, 0.4]))
    rows.append(root @ log_se2(np.linalg.inv(se2([1.5, 1.8, 0.9])) @ values["place"]))
    place = values["place"]
    heading, angle = values["heading"][0], np.arctan2(place[1, 0], place[0, 0])
    rows.append(np.array([3 * (heading - angle), heading**2 - place[0, 2]]))
    return np.concatenate(rows)


def linearized(values):
    """Residuals and their Jacobian by central differences."""
    h = 1e-5
    steps = np.eye(sum(size for _, _, size in START.values())) * h
    columns = [(residuals(values, d) - residuals(values, -d)) / (2 * h) for d in steps]
    return residuals(values, 0 * steps[0]), np.stack(columns, 1)


def test_cost_information_and_vector_are_those_of_differences_of_matrices():
    made = graph()
    r, jacobian = linearized(made.values)
    assert made.cost() == pytest.approx(0.5 * r @ r, rel=1e-11)
    matrix, vector = made.information(KEYS)
    scale = np.linalg.norm(jacobian, axis=0)
    expected = jacobian.T @ jacobian / np.outer(scale, scale)
    np.testing.assert_allclose(matrix / np.outer(scale, scale), expected, atol=1e-6)
    np.testing.assert_allclose(vector, -jacobian.T @ r, rtol=1e-6, atol=1e-6 * np.abs(vector).max())
    assert made.check_gradients()


@pytest.mark.parametrize("solver", ["sparse_normal_cholesky", "iterative_schur"])
def test_at_the_optimum_the_gradient_of_matrices_is_zero(solver):
    tight = {"function_tolerance": 1e-15, "parameter_tolerance": 0, "max_num_iterations": 200}
    made = graph()
    start, found = made.cost(), made.solve(linear_solver_type=solver, **tight)
    r, jacobian = linearized(found.values)
    assert found.summary.final_cost == pytest.approx(0.5 * r @ r, rel=1e-10)
    assert found.summary.final_cost < 0.1 * start
    gradient = jacobian.T @ r / np.linalg.norm(jacobian, axis=0) / np.linalg.norm(r)
    assert np.abs(gradient).max() < 1e-5
