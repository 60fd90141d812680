"""Results of marginalisation: spectra, nullities, fill-in, and no factor that counts twice."""

import copy
import gc
import pickle

import numpy as np
import pytest

import bundle
from bundle.graphs.factors.linear_prior import PriorSpectrum
from tests.graphs.factors.test_toys import line, optimum, poses

EYE = [0.0, 0, 0, 1]


def linear_problem(seed):
    """A random connected linear problem, its whitened rows by dense algebra beside the graph."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 9))
    sizes = rng.integers(1, 4, count)
    begin = np.r_[0, np.cumsum(sizes)]
    graph = bundle.FactorGraph()
    for k, size in enumerate(sizes):
        graph.add_variable(k, rng.normal(size=size))
    rows, right = [], []
    pairs = [(k, (k + 1) % count) for k in range(count)] + [(k, k) for k in range(count)]
    for a, b in pairs:
        keys = [a] if a == b else [a, b]
        m = 4
        blocks = [rng.normal(size=(m, sizes[k])) for k in keys]
        target = rng.normal(size=m)

        def residual(values, blocks=blocks, target=target):
            made = sum(block @ value for block, value in zip(blocks, values, strict=True))
            return made - target, blocks

        graph.add_factor(bundle.FunctionFactor(keys, residual))
        row = np.zeros((m, begin[-1]))
        for k, block in zip(keys, blocks, strict=True):
            row[:, begin[k] : begin[k + 1]] = block
        rows.append(row)
        right.append(target)
    return graph, begin, np.vstack(rows), np.concatenate(right), rng


@pytest.mark.parametrize("seed", range(200))
def test_marginalising_is_exact_on_linear_problems_and_dropping_is_not(seed):
    graph, begin, jacobian, target, rng = linear_problem(seed)
    count = len(graph.keys)
    gone = rng.choice(count, int(rng.integers(1, count)), replace=False).tolist()
    batch = np.linalg.lstsq(jacobian, target, rcond=None)[0]
    kept = [k for k in range(count) if k not in gone]
    columns = np.concatenate([np.arange(begin[k], begin[k + 1]) for k in kept])
    scale = np.abs(batch).max()

    def estimate(rest):
        matrix, vector = rest.information()
        now = np.concatenate([rest.values[k] for k in kept])
        return now + np.linalg.solve(matrix, vector)

    found = estimate(graph.forget(gone))
    condition = np.linalg.cond(jacobian) ** 2
    np.testing.assert_allclose(found, batch[columns], atol=1e-12 * scale * max(1, condition / 1e3))
    assert np.abs(estimate(graph.forget(gone, "drop")) - batch[columns]).max() > 1e-6
    np.testing.assert_allclose(
        estimate(graph.forget(gone, "keep").forget(gone)), found, atol=1e-10 * scale
    )


@pytest.mark.parametrize("how", ["lose", "Drop!", 3])
def test_an_unknown_way_to_forget_is_refused(how):
    with pytest.raises(bundle.InputError, match="how"):
        poses().forget([1], how)


@pytest.mark.parametrize(
    ("degree", "before", "fill"),
    [(2, 7, 1), (3, 10, 3), (4, 13, 6), (10, 31, 45), (50, 151, 1225)],
)
def test_eliminating_a_hub_fills_a_clique(degree, before, fill):
    graph = bundle.FactorGraph()
    graph.add_variable("hub", [0.0])
    for i in range(degree):
        graph.add_variable(i, [0.0])
        graph.add_factor(bundle.BetweenFactor("hub", i, [0.0], 1.0))
    assert np.count_nonzero(graph.information()[0]) == before
    prior = graph.marginalize(["hub"])
    assert np.count_nonzero(prior.Lambda) == degree**2
    assert np.count_nonzero(np.triu(prior.Lambda, 1)) == fill
    assert np.asarray(prior.Lambda).nbytes == 8 * degree**2
    assert prior.spectrum.nullity == 1


def bundle_adjustment(seed=0, stereo=False):
    """Cameras on an arc before points, without any prior; a right camera a metre aside."""
    rng = np.random.default_rng(seed)
    graph = bundle.FactorGraph()
    graph.add_variable("camera", [500.0, 320, 240], fixed=True)
    points = rng.uniform(-2, 2, (12, 3)) + np.array([0, 0, 8.0])
    for j, point in enumerate(points):
        graph.add_variable(("point", j), point)
    for i in range(3):
        sides = [np.array([0.5 * i - 0.5, 0.1 * i, 0.2 * i])]
        if stereo:
            sides.append(sides[0] + [1.0, 0, 0])
        for side, centre in enumerate(sides):
            pose = ("pose", i, side)
            graph.add_variable(pose, [*EYE, *-centre], "se3")
            for j, point in enumerate(points):
                x = point - centre
                pixel = 500 * x[:2] / x[2] + [320, 240] + rng.normal(size=2)
                graph.add_factor(
                    bundle.ReprojectionFactor(pose, "camera", ("point", j), pixel, "SIMPLE_PINHOLE")
                )
        if stereo:
            graph.add_factor(
                bundle.RelativePoseFactor(
                    ("pose", i, 0), ("pose", i, 1), [*EYE, -1, 0, 0], np.eye(6) * 1e6
                )
            )
    return graph, [("point", j) for j in range(len(points))]


def loops(manifold, components):
    """Loops of poses without a prior, not joined."""
    rng = np.random.default_rng(4)
    size = {"se2": 3, "se3": 7}[manifold]
    graph = bundle.FactorGraph()
    for c in range(components):
        for i in range(5):
            graph.add_variable((c, i), rng.standard_normal(size), manifold)
        for i in range(5):
            graph.add_factor(
                bundle.BetweenFactor((c, i), (c, (i + 1) % 5), rng.standard_normal(size), 1.0 + i)
            )
    return graph, [(c, i) for c in range(components) for i in (1, 3)]


@pytest.mark.parametrize(
    ("make", "nullity"),
    [
        (lambda: loops("se2", 1), 3),
        (lambda: loops("se3", 1), 6),
        (lambda: loops("se2", 2), 6),
        (lambda: loops("se3", 2), 12),
        (lambda: bundle_adjustment(), 7),
        (lambda: bundle_adjustment(stereo=True), 6),
    ],
)
def test_nullities_are_kept(make, nullity):
    graph, gone = make()
    # At the optimum the gauge is free to second order too; here J's null space is what counts.
    free = [key for key in graph.keys if key != "camera"]
    whole = PriorSpectrum.of(graph.information(free)[0])
    left = [key for key in free if key not in gone]
    prior = graph.marginalize(gone)
    rest = graph.without(gone)
    rest.add_factor(prior)
    assert whole.nullity == nullity
    assert PriorSpectrum.of(rest.information(left)[0]).nullity == nullity
    assert prior.spectrum.nullity >= nullity


def test_a_spectrum_is_that_of_dense_algebra():
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    matrix = turn @ np.diag([0.0, 1e-3, 2.0, 50.0]) @ turn.T
    matrix = (matrix + matrix.T) / 2
    found = PriorSpectrum.of(matrix)
    assert abs(found.min_eigenvalue) < 1e-13
    assert found.max_eigenvalue == pytest.approx(50, rel=1e-12)
    assert found.nullity == 1 and found.ratio == pytest.approx(1e-3 / 50, rel=1e-9)
    assert found.asymmetry == 0 and found.warning == ""
    matrix[0, 1] += 1e-6 * np.abs(matrix).max()
    skewed = PriorSpectrum.of(matrix)
    assert skewed.asymmetry == pytest.approx(1e-6, rel=1e-3)
    assert "asymmetry" in skewed.warning


@pytest.mark.parametrize(
    ("eigenvalues", "nullity", "word"),
    [([-1e-3, 1.0], 0, "negative"), ([1e-10, 1.0], 0, "condition"), ([0.0, 1.0], 1, "")],
)
def test_a_sick_spectrum_says_so(eigenvalues, nullity, word):
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    found = PriorSpectrum.of(turn @ np.diag(eigenvalues) @ turn.T)
    assert found.nullity == nullity
    assert word in found.warning and bool(word) == bool(found.warning)
    assert ("warning" in repr(found)) == bool(word)


def test_a_spectrum_of_nothing_and_of_mixed_units():
    none = PriorSpectrum.of(np.zeros((2, 2)))
    assert (none.nullity, none.max_eigenvalue, none.ratio, none.asymmetry) == (2, 0, 0, 0)
    mixed = PriorSpectrum.of(np.diag([1e-14, 1e8]))  # metres and pixels: nothing is free
    assert mixed.nullity == 0 and mixed.ratio == pytest.approx(1e-22)
    single = PriorSpectrum.of(np.array([[1, 1], [1, 1 + 1e-7]], np.float32))
    assert single.nullity == 1


def test_re_anchoring_reports_the_jump_of_the_cost():
    graph = line([0.3, -1.0, 2.0], [(0, 1, 1.0, 4.0), (1, 2, 1.0, 4.0)], prior=([0.1], 1.0))
    prior = graph.marginalize(["x0"])
    assert prior.cost_jump == 0
    moved = prior.reanchor({"x1": [0.7]})
    step = moved.linearization_point["x1"] - prior.linearization_point["x1"]
    expected = 0.5 * step @ prior.Lambda @ step - prior.eta @ step
    assert moved.cost_jump == pytest.approx(float(expected), rel=1e-14) and moved.cost_jump != 0
    assert "re-anchored" in repr(moved) and "re-anchored" not in repr(prior)
    costs = []
    for factor in (prior, moved):
        rest = graph.without(["x0"])
        rest.add_factor(factor)
        costs.append(rest.cost())
    assert costs[0] == pytest.approx(costs[1], rel=1e-13)


def test_a_factor_both_kept_and_marginalised_is_refused():
    graph = poses()
    prior = graph.marginalize([1])
    assert set(prior.sources) == {f for f in graph.factors if 1 in f.keys}
    with pytest.raises(bundle.InputError, match=r"count once.*factor [01], "):
        graph.add_factor(prior)
    rest = graph.without([1])
    rest.add_factor(prior)
    with pytest.raises(bundle.InputError, match="count once"):
        rest.add_factor(prior)
    back = rest.with_values({})
    back.add_variable(1, [*EYE, 0, 0, 0], "se3")
    with pytest.raises(bundle.InputError, match=r"count once.*marginalised"):
        back.add_factor(graph.factors[0])
    assert len(back.factors) == len(rest.factors)
    again = graph.factors[0]
    back.add_factor(bundle.BetweenFactor(again.a, again.b, again.measurement, 1.0))  # another one


def test_what_was_marginalised_twice_is_still_known():
    graph = poses()
    first = graph.forget([1])
    second = first.marginalize([2])
    assert graph.factors[0] in second.sources
    moved = second.reanchor({key: graph.values[key] for key in second.keys})
    for prior in (second, moved):
        with pytest.raises(bundle.InputError, match="count once"):
            graph.add_factor(prior)
    # Two priors of the same factor in one graph.
    rest = graph.without([1, 2])
    rest.add_factor(second)
    with pytest.raises(bundle.InputError, match="count once"):
        rest.add_factor(graph.marginalize([1, 2]))


def test_priors_do_not_keep_what_they_were_made_of_alive():
    graph = poses().forget([1])
    (prior,) = (f for f in graph.factors if isinstance(f, bundle.LinearPrior))
    gc.collect()
    assert prior.sources == ()
    for again in (pickle.loads(pickle.dumps(prior)), copy.copy(prior), copy.deepcopy(prior)):
        assert again.spectrum == prior.spectrum and again.sources == ()
    assert pickle.loads(pickle.dumps(graph)).cost() == graph.cost()


def test_a_window_that_forgets_its_oldest_keeps_the_estimate():
    edges = [(i, i + 1, 1.0 + 0.1 * i, 4.0) for i in range(5)] + [(0, 2, 2.3, 9.0), (1, 3, 2, 9.0)]
    graph = line([0.0] * 6, edges, prior=([0.1], 1.0))
    whole = optimum(graph)
    left = graph.forget(["x0"]).forget(["x1"])
    np.testing.assert_allclose(optimum(left), whole[2:], atol=1e-12)


def test_a_graph_without_variables_still_knows_what_its_priors_are_made_of():
    graph, gone = loops("se2", 1)
    used = [factor for factor in graph.factors if not set(gone).isdisjoint(factor.keys)]
    rest = graph.without(gone)
    rest.add_factor(graph.marginalize(gone))
    rest.add_variable("extra", [0.0])
    rest.add_factor(bundle.PriorFactor("extra", [0.0], 1.0))
    for key, value in graph.values.items():
        if key in gone:
            rest.add_variable(key, value, "se2")
    fewer = rest.without(["extra"])
    with pytest.raises(bundle.InputError, match="count once"):
        fewer.add_factor(used[0])
