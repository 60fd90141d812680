"""Factors with right Jacobians, none of which may be accused; and mistakes, all to be caught.

python -m tests.campaigns.jacobians RIGHT WRONG [SEED]

A right one is drawn from every kind of factor on every manifold, ImuFactor at rest and in motion
among them, and from residuals of our own. A mistake is one that somebody makes in a Jacobian of
theirs, in every factor of a graph, which is then solved and checked.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from bundle.graphs.factors.image_factors import TwistTieFactor, VelocityFactor
from bundle.model.cameras import camera_models
from tests.checking.reprojection import left_jacobian, skew
from tests.scenes import PARAMS

SIZES = {"so2": 1, "so3": 3, "se2": 3, "se3": 6, "euclidean": 3}


class Case(NamedTuple):
    """A graph, what it is, and what a checker may call its Jacobians."""

    graph: bundle.FactorGraph
    name: str
    kinds: frozenset[str]


def quaternion(rng, angle=None):
    """A random rotation, of any angle or about the one given."""
    if angle is None:
        return Rotation.random(random_state=rng).as_quat()
    return Rotation.from_rotvec(angle * rng.standard_normal(3)).as_quat()


def value_of(manifold, rng):
    """A random value; one in four is the identity, where parameters are zero."""
    scale = 10.0 ** rng.uniform(-1, 2)
    at_rest = rng.random() < 0.25
    if manifold == "so2":
        return np.zeros(1) if at_rest else rng.uniform(-3, 3, 1)
    if manifold == "so3":
        return np.array([0, 0, 0, 1.0]) if at_rest else quaternion(rng)
    if manifold == "se2":
        return np.zeros(3) if at_rest else np.append(scale * rng.normal(size=2), rng.uniform(-3, 3))
    if manifold == "se3":
        identity = np.array([0, 0, 0, 1.0, 0, 0, 0])
        return identity if at_rest else np.append(quaternion(rng), scale * rng.normal(size=3))
    return np.zeros(3) if at_rest else scale * rng.normal(size=3)


def moved(manifold, value, rng, size=0.3):
    """A value near another."""
    step = size * rng.standard_normal(SIZES[manifold])
    return value + step if manifold == "euclidean" else _core.retract(manifold, value, step)


def information(rng, n):
    """Positive definite, with sigmas of different sizes."""
    root = np.eye(n) + 0.3 * rng.standard_normal((n, n))
    sigma = 10.0 ** rng.uniform(-2, 0, n)
    return root @ root.T / np.outer(sigma, sigma)


def imu(rng):
    """Two states some samples apart; at rest, in motion, or with gravity and a scale to find."""
    noise = bundle.ImuNoise(1.7e-4, 2e-3, 1.9e-5, 3e-3)
    rest = rng.random() < 0.5
    bias = np.zeros(6) if rng.random() < 0.5 else rng.normal(0, [0.02] * 3 + [0.1] * 3)
    motion = bundle.Preintegration(noise, bias[:3], bias[3:])
    count = int(rng.integers(5, 60))
    gyro = (0 if rest else 1) * rng.normal(0, 0.3, (count, 3)) + 1e-3 * rng.normal(size=(count, 3))
    accel = (0 if rest else 1) * rng.normal(0, 1, (count, 3)) + [0, 0, 9.81]
    motion.integrate(gyro, accel, np.full(count, 0.005))
    turn = [0, 0, 0, 1] if rng.random() < 0.5 else quaternion(rng)
    start = np.concatenate([
        turn,
        *(np.zeros(3) if rng.random() < 0.5 else rng.normal(0, s, 3) for s in (3, 1)),
        bias,
    ])  # fmt: skip
    end = motion.predict(start) if rng.random() < 0.5 else start
    graph = bundle.FactorGraph()
    for name, state in (("0", start), ("1", end)):
        graph.add_variable("x" + name, state[:7], "se3")
        graph.add_variable("v" + name, state[7:10])
        graph.add_variable("b" + name, bias)
    graph.add_factor(bundle.ImuFactor("x0", "v0", "b0", "x1", "v1", motion))
    graph.add_factor(bundle.BiasWalkFactor("b0", "b1", noise, 0.1))
    return graph


def on_manifold(rng, kind):
    """A factor of values on a random manifold."""
    manifold = str(rng.choice(list(SIZES)))
    n = SIZES[manifold]
    graph = bundle.FactorGraph()
    values = [value_of(manifold, rng)]
    values.append(moved(manifold, values[0], rng))
    for key, value in zip("ab", values, strict=True):
        graph.add_variable(key, value, manifold)
    where = {key: moved(manifold, v, rng, 0.1) for key, v in zip("ab", values, strict=True)}
    if kind == "prior":
        graph.add_factor(bundle.PriorFactor("a", where["a"], information(rng, n)))
    elif kind == "between":
        zero = value_of(manifold, np.random.default_rng(0)) * 0
        if manifold in ("so3", "se3"):
            zero[3] = 1
        step = _core.local_coordinates(manifold, where["a"], where["b"])
        measured = zero + step if manifold == "euclidean" else _core.retract(manifold, zero, step)
        graph.add_factor(bundle.BetweenFactor("a", "b", measured, information(rng, n)))
    else:
        manifolds = {"a": manifold, "b": manifold}
        matrix = information(rng, 2 * n)
        if kind == "linear":
            eta = matrix @ rng.standard_normal(2 * n)
            prior = bundle.LinearPrior(matrix, eta, where, ("a", "b"), manifolds=manifolds)
        else:
            root = np.linalg.cholesky(matrix).T
            vector = rng.standard_normal(2 * n)
            prior = bundle.SquareRootPrior(root, vector, where, ("a", "b"), manifolds=manifolds)
        graph.add_factor(prior)
    return graph


def on_pose(rng, kind):
    """A factor of a camera's pose, or of two."""
    graph = bundle.FactorGraph()
    pose = np.append(quaternion(rng), rng.normal(size=3))
    graph.add_variable("pose", pose, "se3")
    if kind == "position":
        arm = rng.normal(0, 0.1, 3) * (rng.random() < 0.5)
        weights = information(rng, 3)
        graph.add_factor(bundle.PositionFactor("pose", rng.normal(size=3), weights, lever_arm=arm))
    elif kind == "velocity":
        arm = rng.normal(0, 0.1, 3) * (rng.random() < 0.5)
        graph.add_variable("twist", rng.normal(0, 0.1, 6) * (rng.random() < 0.75))
        graph.add_variable("readout", rng.uniform(0.1, 1, 1))
        names, weights = ("pose", "twist", "readout"), information(rng, 3)
        graph.add_factor(VelocityFactor(*names, rng.normal(size=3), weights, lever_arm=arm))
    elif kind == "tie":
        graph.add_variable("other", moved("se3", pose, rng), "se3")
        graph.add_variable("twist", rng.normal(0, 0.1, 6) * (rng.random() < 0.75))
        graph.add_variable("readout", rng.uniform(0.1, 1, 1))
        sigmas = 0.01, np.inf if rng.random() < 0.25 else 0.02
        names = "twist", "readout", "pose", "other"
        graph.add_factor(TwistTieFactor(*names, float(rng.uniform(1, 10)), *sigmas))
    elif kind == "relative":
        graph.add_variable("other", moved("se3", pose, rng), "se3")
        measured = np.append(quaternion(rng, 0.3), rng.normal(size=3))
        weights = information(rng, 6)
        graph.add_factor(bundle.RelativePoseFactor("pose", "other", measured, weights))
    else:
        model = str(rng.choice(sorted(camera_models())))
        graph.add_variable("camera", PARAMS[model])
        point = np.array([*rng.uniform(-0.3, 0.3, 2), 1]) * rng.uniform(2, 6)
        world = Rotation.from_quat(pose[:4]).inv().apply(point - pose[4:])
        graph.add_variable("point", world)
        xy = rng.uniform(0, 500, 2)
        graph.add_factor(bundle.ReprojectionFactor("pose", "camera", "point", xy, model))
        weights = 1 / rng.uniform(0.01, 0.1)
        graph.add_factor(bundle.ScalarPriorFactor("camera", 0, PARAMS[model][0], 1 / weights))
    return graph


def right(rng) -> Case:
    """A graph of factors whose Jacobians are right."""
    draws: dict[str, Callable] = {"imu": imu}
    for kind in ("prior", "between", "linear", "square_root"):
        draws[kind] = lambda r, kind=kind: on_manifold(r, kind)
    for kind in ("position", "velocity", "tie", "relative", "reprojection"):
        draws[kind] = lambda r, kind=kind: on_pose(r, kind)
    for name in RESIDUALS:
        draws[name] = lambda r, name=name: make_graph(r, name, None)
    name = str(rng.choice(list(draws)))
    return Case(draws[name](rng), name, frozenset({"correct"}))


# Residuals of our own: each draws its variables and the parts of r and J without weights.


def matrix(value):
    """Rotation matrix of a quaternion."""
    return Rotation.from_quat(value).as_matrix()


def bearing(rng):
    """Range and bearing of a landmark from a pose in the plane."""

    def function(values):
        (x, y, angle), landmark = values
        dx, dy = landmark - [x, y]
        square = dx * dx + dy * dy
        length = np.sqrt(square)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        by_landmark = np.array([[dx / length, dy / length], [-dy / square, dx / square]])
        by_pose = np.hstack([-by_landmark @ turn, [[0], [-1]]])
        off = np.arctan2(dy, dx) - angle
        return np.array([length, np.arctan2(np.sin(off), np.cos(off))]), [by_pose, by_landmark]

    return function, [
        ("se2", np.append(rng.uniform(-2, 2, 2), rng.uniform(-3, 3))),
        ("euclidean", rng.uniform(4, 8, 2)),
    ]


def align(rng):
    """A turned vector."""

    def function(values):
        turn = matrix(values[0])
        return turn @ values[1], [-turn @ skew(values[1]), turn]

    return function, [("so3", quaternion(rng)), ("euclidean", rng.uniform(1, 3, 3))]


def sighting(rng):
    """A point in the frame of a body, whose pose is world_from_body."""

    def function(values):
        pose, point = values
        turn = matrix(pose[:4])
        seen = turn.T @ (point - pose[4:])
        return seen, [np.hstack([skew(seen), -np.eye(3)]), turn.T]

    return function, [
        ("se3", np.append(quaternion(rng), rng.normal(0, 2, 3))),
        ("euclidean", rng.uniform(3, 6, 3)),
    ]


def turning(rng):
    """The logarithm of a rotation from one to another."""
    measured = Rotation.random(random_state=rng)

    def function(values):
        a, b = Rotation.from_quat(values[0]), Rotation.from_quat(values[1])
        error = (measured.inv() * a.inv() * b).as_rotvec()
        inverse = np.linalg.inv(left_jacobian(-error))
        return error, [-inverse @ (b.inv() * a).as_matrix(), inverse]

    a = Rotation.random(random_state=rng)
    b = a * measured * Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    return function, [("so3", a.as_quat()), ("so3", b.as_quat())]


def six_numbers(rng):
    """A point moved by a rotation vector and a translation."""

    def function(values):
        pose, point = values
        turn = Rotation.from_rotvec(pose[:3]).as_matrix()
        by_turn = -skew(turn @ point) @ left_jacobian(pose[:3])
        return turn @ point + pose[3:], [np.hstack([by_turn, np.eye(3)]), turn]

    return function, [
        ("euclidean", np.append(rng.uniform(0.3, 1, 3), rng.normal(size=3))),
        ("euclidean", rng.uniform(1, 3, 3)),
    ]


def decay(rng):
    """A curve at four times."""
    times = np.array([0.0, 0.5, 1.0, 2.0])

    def function(values):
        a, b, c = values[0]
        e = np.exp(-b * times)
        return a * e + c, [np.column_stack([e, -a * times * e, np.ones(4)])]

    return function, [("euclidean", rng.uniform(0.5, 2, 3))]


RESIDUALS = {f.__name__: f for f in (bearing, align, sighting, turning, six_numbers, decay)}


def make_graph(rng, name, spoil, count=8):
    """Copies of one residual, measured with noise, with variables of their own, held by priors."""
    graph = bundle.FactorGraph()
    for i in range(count):
        function, variables = RESIDUALS[name](rng)
        truth = [value for _, value in variables]
        keys = [f"{chr(97 + v)}{i}" for v in range(len(variables))]
        first = function(truth)[0]
        rows = len(first)
        weights = np.linalg.cholesky(information(rng, rows)).T / 10
        noise = rng.normal(0, 0.02, rows)
        held_still = 0 if name == "turning" else 1

        def residual(
            values, function=function, first=first, weights=weights, noise=noise, keep=held_still
        ):
            error, jacobians = function(values)
            error = error - keep * (first + noise)
            right_ones = [weights @ jacobian for jacobian in jacobians]
            if spoil is None:
                return weights @ error, right_ones
            return weights @ error, spoil(values, jacobians, right_ones, error)

        for key, (manifold, value) in zip(keys, variables, strict=True):
            start = value + 0.05 * rng.standard_normal(len(value))
            if manifold != "euclidean":
                start = _core.retract(manifold, value, 0.05 * rng.normal(size=SIZES[manifold]))
            graph.add_variable(key, start, manifold)
            size = SIZES[manifold] if manifold != "euclidean" else len(value)
            graph.add_factor(bundle.PriorFactor(key, value, np.full(size, 0.01) * np.eye(size)))
        graph.add_factor(bundle.FunctionFactor(keys, residual))
    return graph


# Mistakes: (values, Jacobians without weights, right Jacobians, error) -> wrong Jacobians.


def column(change, block, j):
    """A change of one column."""

    def spoil(values, _plain, jacobians, _error):
        wrong = [jacobian.copy() for jacobian in jacobians]
        wrong[block][:, j] = change(wrong[block][:, j], values)
        return wrong

    return spoil


def block_of(change, block):
    """A change of one block."""

    def spoil(values, _plain, jacobians, _error):
        wrong = [jacobian.copy() for jacobian in jacobians]
        wrong[block] = change(wrong[block], values[block])
        return wrong

    return spoil


def swap_rows(_values, _plain, jacobians, _error):
    return [jacobian[[1, 0, *range(2, len(jacobian))]] for jacobian in jacobians]


def unweighted(_values, plain, _jacobians, _error):
    return plain


def without_logarithm(_values, plain, jacobians, error):
    """J_r^-1 of the error is missing: W A in place of W J_r^-1 A."""
    weights = jacobians[1] @ np.linalg.inv(plain[1])
    return [weights @ left_jacobian(-error) @ jacobian for jacobian in plain]


def without_left_jacobian(jacobian, value):
    wrong = jacobian.copy()
    wrong[:, :3] = wrong[:, :3] @ np.linalg.inv(left_jacobian(value[:3]))
    return wrong


def turn_back(jacobian, value):
    """By d of Exp(d) R."""
    return jacobian @ matrix(value).T


def translation_of_world(jacobian, value):
    wrong = jacobian.copy()
    if len(value) == 3:  # se2
        c, s = np.cos(value[2]), np.sin(value[2])
        wrong[:, :2] = wrong[:, :2] @ np.array([[c, s], [-s, c]])
    else:
        wrong[:, 3:] = wrong[:, 3:] @ matrix(value[:4]).T
    return wrong


def left_pose(jacobian, value):
    """By d of Exp(d) X."""
    turn, back = matrix(value[:4]), matrix(value[:4]).T
    by_turn = (jacobian[:, :3] - jacobian[:, 3:] @ back @ skew(value[4:]) @ turn) @ back
    return np.hstack([by_turn, jacobian[:, 3:] @ back])


def translation_first(jacobian, _value):
    return np.hstack([jacobian[:, 3:], jacobian[:, :3]])


def swapped_columns(jacobian, _value):
    return jacobian[:, [1, 0, *range(2, jacobian.shape[1])]]


def transposed(jacobian, _value):
    return jacobian.T


def negated(jacobian, _value):
    return -jacobian


DEGREE = np.pi / 180
MISTAKES = {
    "sign of a column": (column(lambda c, _: -c, 0, 0), "sign", RESIDUALS),
    "sign of the last column": (column(lambda c, _: -c, -1, -1), "sign", RESIDUALS),
    "sign of a block": (block_of(negated, 0), "sign", RESIDUALS),
    "twice a column": (column(lambda c, _: 2 * c, 0, 1), "factor", RESIDUALS),
    "1.3 times a column": (column(lambda c, _: 1.3 * c, -1, 0), "factor", RESIDUALS),
    "degrees": (column(lambda c, _: DEGREE * c, 0, 2), "degrees", RESIDUALS),
    "degrees the other way": (column(lambda c, _: c / DEGREE, 0, 0), "degrees", RESIDUALS),
    "no derivative": (column(lambda c, _: 0 * c, 0, 1), "zero", RESIDUALS),
    "swapped columns": (block_of(swapped_columns, 0), "swapped", RESIDUALS),
    "swapped columns of the last": (block_of(swapped_columns, -1), "swapped", RESIDUALS),
    "swapped rows": (swap_rows, "swapped_rows", RESIDUALS),
    "weights of the residual alone": (unweighted, "whitening", RESIDUALS),
    "times a parameter": (
        column(lambda c, v: c * v[-1][0], -1, -1),
        "scaled_by_parameter",
        ("bearing", "align", "sighting", "six_numbers", "decay"),
    ),
    "transposed": (block_of(transposed, -1), "transposed", ("align", "sighting", "six_numbers")),
    "left rotation": (block_of(turn_back, 0), "perturbation", ("align", "turning")),
    "left pose": (block_of(left_pose, 0), "perturbation", ("sighting",)),
    "translation of the world": (
        block_of(translation_of_world, 0),
        "frame",
        ("bearing", "sighting"),
    ),
    "translation first": (block_of(translation_first, 0), "order", ("sighting",)),
    "no J_l": (block_of(without_left_jacobian, 0), "perturbation", ("six_numbers",)),
    "no J_r^-1": (without_logarithm, "logarithm", ("turning",)),
}


def planted(rng, place: int) -> Case:
    """A graph with a mistake in all of its functions; the mistakes take turns."""
    name, (spoil, kind, residuals) = list(MISTAKES.items())[place % len(MISTAKES)]
    residual = str(rng.choice(list(residuals)))
    return Case(make_graph(rng, residual, spoil), f"{name}, {residual}", frozenset({kind}))


class Verdict(NamedTuple):
    """Verdicts on a case."""

    name: str
    expected: frozenset[str]
    verdict: str
    kinds: frozenset[str]
    warnings: tuple[str, ...]

    @property
    def is_caught(self) -> bool:
        """True if the solve reports a wrong Jacobian."""
        return bool({"wrong_factor", "suspicious_steps"} & set(self.warnings))

    @property
    def is_named(self) -> bool:
        """True if the checker names the mistake, and no other."""
        return self.kinds == self.expected


def judge(case: Case, seed: int) -> Verdict:
    """Check a case, and solve it."""
    functions = [f for f in case.graph.factors if isinstance(f, bundle.FunctionFactor)]
    report = case.graph.check_gradients(functions[:1] or None, seed=seed)
    kinds = frozenset().union(*(r.kinds for r in report.reports.values()))
    square_root = bool(seed % 3 == 0) or None
    try:
        warnings = case.graph.solve(square_root=square_root).summary.warning_kinds
    except bundle.InputError:
        warnings = ()
    return Verdict(case.name, case.kinds, report.verdict, kinds, warnings)


def campaign(num_right: int, num_wrong: int, seed: int = 0) -> tuple[list[Verdict], list[Verdict]]:
    """Return the verdicts on right factors and on planted mistakes."""
    rng = np.random.default_rng(seed)
    rights = [judge(right(rng), seed + k) for k in range(num_right)]
    return rights, [judge(planted(rng, k), seed + k) for k in range(num_wrong)]


def main(arguments: list[str]) -> int:
    """Print what went wrong; exit with the number of misjudgements."""
    rights, wrongs = campaign(*map(int, arguments))
    accused = [v for v in rights if v.verdict == "wrong" or v.is_caught]
    undecided = [v for v in rights if v.verdict == "undecided"]
    missed = [v for v in wrongs if not v.is_caught or v.verdict != "wrong"]
    unnamed = [v for v in wrongs if not v.is_named]
    for title, verdicts in (
        ("accused", accused),
        ("undecided", undecided),
        ("missed", missed),
        ("not named", unnamed),
    ):
        print(f"{title}: {len(verdicts)}")
        for v in verdicts:
            found = ", ".join(sorted(v.kinds))
            print(f"  {v.name}: {v.verdict}, {found}; {', '.join(v.warnings)}")
    return len(accused) + len(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
