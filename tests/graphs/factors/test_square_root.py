"""Square roots: steps by QR, digits, and priors that stay positive in single precision."""

import copy
import pickle

import numpy as np
import pytest

import bundle
from bundle.graphs.factors.factor_graph import DigitsLeft
from bundle.graphs.factors.linear_prior import PriorSpectrum
from tests.graphs.factors.test_marginalization import loops
from tests.graphs.factors.test_toys import EXACT, line, poses

CONVERGED = {
    "function_tolerance": 0.0,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 0.0,
    "max_num_iterations": 200,
}


def with_condition(kappa, seed, rows=20, columns=8):
    """A consistent linear problem J x = b whose singular values go down to 1 / kappa."""
    rng = np.random.default_rng(seed)
    left = np.linalg.qr(rng.normal(size=(rows, columns)))[0]
    right = np.linalg.qr(rng.normal(size=(columns, columns)))[0]
    jacobian = left @ np.diag(np.logspace(0, -np.log10(kappa), columns)) @ right.T
    return jacobian, rng.normal(size=columns)


def linear(jacobian, vector):
    """A graph of one variable and these rows."""
    zero = np.zeros(jacobian.shape[1])
    graph = bundle.FactorGraph()
    graph.add_variable("x", zero)
    graph.add_factor(bundle.SquareRootPrior(jacobian, vector, {"x": zero}, ["x"]))
    return graph


@pytest.mark.parametrize(
    ("kappa", "by_normal_equations", "by_root"), [(1e3, 10, 13), (1e5, 6, 11), (1e8, 0, 8)]
)
def test_digits_by_normal_equations_and_by_qr(kappa, by_normal_equations, by_root):
    found = []
    for seed in range(7):
        jacobian, truth = with_condition(kappa, seed)
        graph = linear(jacobian, jacobian @ truth)
        digits = graph.digits()
        scaled = jacobian / np.linalg.norm(jacobian, axis=0)
        assert digits.condition_number == pytest.approx(np.linalg.cond(scaled), rel=0.05)
        assert abs(digits.normal_equations - by_normal_equations) <= 1
        assert abs(digits.square_root - by_root) <= 1
        root = graph.solve(square_root=True, **CONVERGED).values["x"]
        normal = np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ (jacobian @ truth))
        found.append([
            -np.log10(np.linalg.norm(x - truth) / np.linalg.norm(truth)) for x in (root, normal)
        ])  # fmt: skip
    root_digits, normal_digits = np.median(found, axis=0)
    assert root_digits > by_root - 1
    assert abs(normal_digits - by_normal_equations) < 1.5
    assert root_digits > normal_digits + 2


@pytest.mark.parametrize(("kappa", "solver"), [(1e3, "DENSE_NORMAL_CHOLESKY"), (1e8, "SPARSE_QR")])
def test_auto_takes_qr_where_digits_run_out(kappa, solver):
    jacobian, truth = with_condition(kappa, 0)
    graph = linear(jacobian, jacobian @ truth)
    summary = graph.solve().summary
    assert summary.linear_solver_type_used == solver
    assert ("digit" in summary.linear_solver_choice) == (solver == "SPARSE_QR")
    held = graph.solve(square_root=False).summary
    assert held.linear_solver_type_used == "DENSE_NORMAL_CHOLESKY"
    named = graph.solve(linear_solver_type="dense_qr").summary  # who names one gets it
    assert named.linear_solver_type_used == "DENSE_QR" and named.backend_used == "CERES"


@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg", "subspace_dogleg"])
@pytest.mark.parametrize("manifold", ["se2", "se3"])
def test_qr_and_normal_equations_take_the_same_steps(manifold, strategy):
    graph = poses(manifold=manifold, seed=8)
    options = {"trust_region_strategy_type": strategy, "max_num_iterations": 6}
    ours = graph.solve(square_root=True, **options)
    theirs = graph.solve(square_root=False, linear_solver_type="dense_qr", **options)
    np.testing.assert_allclose(ours.iterations["cost"], theirs.iterations["cost"], rtol=1e-7)
    assert len(ours.iterations["cost"]) > 3
    for key, value in theirs.values.items():
        np.testing.assert_allclose(ours.values[key], value, atol=1e-5)
    assert ours.summary.backend_used == "FUSED"
    assert ours.summary.num_residuals == theirs.summary.num_residuals
    assert ours.summary.num_parameters == theirs.summary.num_parameters


def test_qr_with_losses_held_coordinates_and_functions_in_python():
    graph = bundle.FactorGraph()
    graph.add_variable("held", [0, 0, 0], "se2", fixed=True)
    graph.add_variable("half", [1.0, 0.3, 0.2], "se2", fixed=[1])
    graph.add_variable("plain", [2.0, 1.0])
    graph.add_variable("unused", [1.0], fixed=True)
    graph.add_factor(bundle.BetweenFactor("held", "half", [1.2, 0.1, 0.1], 4.0, loss="cauchy"))
    graph.add_factor(
        bundle.FunctionFactor(
            ["half", "plain"],
            lambda v: (
                np.array([v[1][0] - v[0][2], v[1][1] ** 2 - 2]),
                [
                    np.array([[0, 0, -1.0], [0, 0, 0]]),
                    np.array([[1.0, 0], [0, 2 * v[1][1]]]),
                ],
            ),
        )
    )
    ours = graph.solve(square_root=True, **CONVERGED)
    theirs = graph.solve(square_root=False, **CONVERGED)
    assert ours.summary.final_cost == pytest.approx(theirs.summary.final_cost, rel=1e-12)
    for key, value in theirs.values.items():
        np.testing.assert_allclose(ours.values[key], value, atol=1e-7)
    assert ours.values["plain"][1] == pytest.approx(2**0.5, abs=1e-12)


def test_what_a_function_raises_leaves_a_solve_by_qr():
    def fail(values):
        if values[0][0] < 0.9:
            raise ZeroDivisionError("mine")
        return values[0], [np.eye(1)]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0])
    graph.add_factor(bundle.FunctionFactor(["x"], fail))
    with pytest.raises(ZeroDivisionError, match="mine"):
        graph.solve(square_root=True)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"backend": "ceres"}, "backend"),
        ({"linear_solver_type": "dense_qr"}, "linear_solver_type"),
    ],
)
def test_options_that_exclude_square_roots(options, word):
    with pytest.raises(bundle.InputError, match=word):
        line([0.0], [], prior=([0.0], 1.0)).solve(square_root=True, **options)


def test_misuse_of_square_roots_is_refused():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0], lower=0)
    graph.add_factor(bundle.PriorFactor("x", [0.0], 1.0))
    with pytest.raises(bundle.InputError, match="bounds"):
        graph.solve(square_root=True)
    with pytest.raises(bundle.InputError, match="square_root"):
        graph.solve(square_root="yes")
    held = bundle.FactorGraph()
    held.add_variable("x", [1.0], fixed=True)
    held.add_factor(bundle.PriorFactor("x", [0.0], 1.0))
    for ask in (held.digits, lambda: held.solve(square_root=True)):
        with pytest.raises(bundle.InputError, match="free"):
            ask()
    with pytest.raises(bundle.InputError, match="precision"):
        poses().marginalize([1], precision="half")
    for root, vector in (([[1.0, 2]], [1.0]), ([[np.nan]], [1.0]), ([[1.0]], [1.0, 2]), ([1], [1])):
        with pytest.raises(bundle.InputError, match="SquareRootPrior"):
            bundle.SquareRootPrior(root, vector, {"x": [0.0]}, ["x"])
    with pytest.raises(bundle.InputError, match="found 0"):
        bundle.SquareRootPrior([[0.0]], [0.0], {"x": [0.0]}, ["x"])


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("make", [lambda: (poses(seed=2), [1, 2]), lambda: loops("se2", 1)])
def test_both_marginalisations_leave_the_same(make, precision):
    graph, gone = make()
    plain = graph.marginalize(gone)
    root = graph.marginalize(gone, square_root=True, precision=precision)
    assert isinstance(root, bundle.SquareRootPrior) and root.keys == plain.keys
    tolerance = {"double": 1e-12, "single": 2e-5}[precision]
    np.testing.assert_allclose(
        root.Lambda, plain.Lambda, atol=tolerance * np.abs(plain.Lambda).max()
    )
    np.testing.assert_allclose(root.eta, plain.eta, atol=tolerance * np.abs(plain.eta).max() * 10)
    if precision == "double":
        assert root.spectrum.nullity == plain.spectrum.nullity
        assert root.spectrum.max_eigenvalue == pytest.approx(plain.spectrum.max_eigenvalue)
        rest = graph.forget(gone, square_root=True)
        whole = graph.information([key for key in graph.keys if key not in gone])
        np.testing.assert_allclose(
            rest.information()[0], whole[0], atol=1e-11 * np.abs(whole[0]).max()
        )
    np.testing.assert_array_equal(root.Lambda, root.Lambda.T)


def test_a_square_root_prior_acts_as_its_linear_prior():
    graph = poses(seed=6)
    root = graph.marginalize([1, 2], square_root=True)
    plain = bundle.LinearPrior(
        root.Lambda, root.eta, root.linearization_point, root.keys, manifolds=root.manifolds
    )
    values = {key: np.asarray(graph.values[key]) + 0.05 for key in root.keys}
    moved, moved_plain = root.reanchor(values), plain.reanchor(values)
    assert moved.cost_jump == pytest.approx(moved_plain.cost_jump, rel=1e-9)
    np.testing.assert_allclose(moved.eta, moved_plain.eta, atol=1e-10)
    solved = []
    for prior in (root, plain):
        rest = graph.without([1, 2])
        rest.add_factor(prior)
        assert rest.check_gradients(prior)
        solved.append(np.concatenate(list(rest.solve(**EXACT).values.values())))
    np.testing.assert_allclose(*solved, atol=1e-7)
    for again in (pickle.loads(pickle.dumps(root)), copy.deepcopy(root)):
        assert repr(again) == repr(root) and again.spectrum == root.spectrum
        with pytest.raises(ValueError, match=r"read-only|WRITEABLE"):
            np.asarray(again.root)[...] = 0


@pytest.mark.parametrize("square_root", [True, False])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_direction_that_nothing_determines_is_named(square_root, precision):
    graph = bundle.FactorGraph()
    for key in ("a", "b", "c"):
        graph.add_variable(key, [0.0, 0.0])
    sees = np.array([[1.0, 0.0]])
    for pair in (("a", "b"), ("b", "c")):
        graph.add_factor(
            bundle.FunctionFactor(pair, lambda v: (sees @ (v[1] - v[0]), [-sees, sees]))
        )
    with pytest.raises(bundle.InputError, match=r"variable 'b'.*determine"):
        graph.marginalize(["b"], square_root=square_root, precision=precision)


def chain(square_root, steps, precision):
    """Slide along positions and velocities; return the priors' spectra, until one is refused."""
    rng = np.random.default_rng(1)
    graph = bundle.FactorGraph()
    graph.add_variable(0, [0.0, 1.0])
    graph.add_factor(bundle.PriorFactor(0, [0.0, 1.0], np.diag([1.0, 0.1])))
    weights = np.array([3e3, 1e2])
    moves = np.array([[1.0, 0.1], [0.0, 1.0]])
    spectra = []
    for k in range(steps):
        graph.add_variable(k + 1, moves @ graph.values[k])
        target = weights * rng.normal(size=2) * 1e-3
        graph.add_factor(
            bundle.SquareRootPrior(
                np.hstack((-weights[:, None] * moves, np.diag(weights))),
                target,
                {k: graph.values[k], k + 1: graph.values[k + 1]},
                [k, k + 1],
            )
        )
        try:
            graph = graph.forget([k], square_root=square_root, precision=precision)
        except bundle.InputError as error:
            assert "determine" in str(error) or "semidefinite" in str(error)
            break
        spectra.append(graph.factors[0].spectrum)
        if spectra[-1].min_eigenvalue <= 0:
            break
    return spectra


def test_a_root_in_single_precision_stays_positive_where_the_plain_prior_fails():
    exact = chain(True, 1000, "double")
    root = chain(True, 1000, "single")
    plain = chain(False, 1000, "single")
    assert len(exact) == len(root) == 1000
    assert min(spectrum.min_eigenvalue for spectrum in root) > 0
    for ours, truth in zip(root[::100], exact[::100], strict=True):
        assert ours.min_eigenvalue == pytest.approx(truth.min_eigenvalue, rel=0.05)
        assert ours.max_eigenvalue == pytest.approx(truth.max_eigenvalue, rel=0.05)
    assert len(plain) < 1000  # refused, or no more positive


def test_the_spectrum_of_a_root_has_twice_the_digits():
    root = np.diag([1.0, 1e-10])
    found = PriorSpectrum.of_root(root)
    assert found.min_eigenvalue == pytest.approx(1e-20) and found.nullity == 0
    wide = PriorSpectrum.of_root(np.array([[3.0, 0.0, 0.0]]))
    assert (wide.nullity, wide.max_eigenvalue, wide.ratio) == (2, 9.0, 1.0)


@pytest.mark.parametrize("square_root", [True, False])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_direction_that_only_rounding_determines_is_refused(square_root, precision):
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(9, 2)) @ rng.normal(size=(2, 3))  # rank 2, but for rounding
    zero = np.zeros(3)
    graph = bundle.FactorGraph()
    for key in ("a", "b"):
        graph.add_variable(key, zero)
    graph.add_factor(
        bundle.SquareRootPrior(
            np.hstack((rows, rng.normal(size=(9, 3)))),
            zero.repeat(3),
            {"a": zero, "b": zero},
            ["a", "b"],
        )
    )
    with pytest.raises(bundle.InputError, match=r"variable 'a'.*determine"):
        graph.marginalize(["a"], square_root=square_root, precision=precision)


def motion(units=1.0, fixed=False):
    """Positions and velocities; of those that leave, one coordinate in other units, or held."""
    rng = np.random.default_rng(9)
    graph = bundle.FactorGraph()
    for key in "abc":
        graph.add_variable(key, rng.normal(size=2), fixed=[1] if fixed and key == "b" else False)
    graph.add_factor(bundle.PriorFactor("a", [0.0, 0.0], 2.0))
    for first, second in (("a", "b"), ("b", "c"), ("a", "c")):
        j, k = rng.normal(size=(2, 3, 2))
        j, k = (m * np.where(np.array(key) == "b", [units, 1.0], 1.0) for m, key in
                ((j, first), (k, second)))  # fmt: skip
        r = rng.normal(size=3)
        graph.add_factor(
            bundle.FunctionFactor([first, second], lambda _, j=j, k=k, r=r: (r, [j, k]))
        )
    return graph


@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("square_root", [False, True])
def test_what_leaves_may_have_any_units_and_held_coordinates(square_root, precision):
    how = {"square_root": square_root, "precision": precision}
    for fixed in (False, True):
        plain, _ = motion(fixed=fixed).information(["a", "c"])
        for units in (1.0, 1e-15, 1e15):
            graph = motion(units, fixed).forget(["b"], **how)
            matrix, _ = graph.information(["a", "c"])
            np.testing.assert_allclose(
                matrix, plain, rtol=1e-9 if precision == "double" else 1e-4, atol=1e-4
            )


def test_a_rank_that_is_missing_leaves_no_digit():
    found = DigitsLeft.of(1.0, 1e-3, 5, [2])
    assert found.condition_number == np.inf and not found.needs_square_root
    assert DigitsLeft.of(1.0, 1e-8, 5, []).needs_square_root


def test_bounds_keep_auto_from_qr():
    jacobian, truth = with_condition(1e8, 0)
    graph = linear(jacobian, jacobian @ truth)
    assert graph.digits().needs_square_root
    bounded = bundle.FactorGraph()
    bounded.add_variable("x", np.zeros(8), lower=-100.0, upper=100.0)
    bounded.add_factor(graph.factors[0])
    assert bounded.solve().summary.backend_used == "CERES"
