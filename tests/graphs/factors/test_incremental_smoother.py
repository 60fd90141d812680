"""Incremental smoothing against the same graph solved in one batch."""

import sys

import numpy as np
import pytest

import bundle
from tests.graphs.factors.test_toys import EXACT

EYE = [0.0, 0, 0, 1]


def test_without_gtsam_there_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(bundle.InputError, match="pip install gtsam"):
        bundle.IncrementalSmoother()


@pytest.fixture
def smoother():
    pytest.importorskip("gtsam")
    return bundle.IncrementalSmoother(relinearize_threshold=1e-4)


STARTS = {
    "euclidean": [0.0, 0.0, 0.0, 0.0],
    "so2": [0.0],
    "so3": EYE,
    "se2": [0.0, 0.0, 0.0],
    "se3": [*EYE, 0.0, 0.0, 0.0],
}
STEPS = {
    "euclidean": [1.0, 0.5, 0.0, -1.0],
    "so2": [0.5],
    "so3": [0.0, 0.1, 0.2, 1.0],
    "se2": [1.0, 0.1, 0.6],
    "se3": [0.1, 0.0, 0.3, 1.0, 1.0, 0.2, -0.1],
}


def composed(manifold, a, step):
    """The value after a step, by the core's retractions."""
    from bundle import _core

    start = np.array(STARTS[manifold])
    return _core.retract(manifold, a, _core.local_coordinates(manifold, start, np.array(step)))


def build(smoother, manifold, count=12, loss="trivial"):
    rng = np.random.default_rng(5)
    step = np.array(STEPS[manifold])
    value = np.array(STARTS[manifold])
    tangent = {"so3": 3, "se3": 6}.get(manifold, len(value))
    root = rng.normal(size=(tangent, tangent))
    information = root @ root.T + tangent * np.eye(tangent)
    smoother.add_variable("v0", value, manifold)
    smoother.add_factor(bundle.PriorFactor("v0", value, 100.0))
    smoother.update()
    for k in range(1, count):
        noisy = step + 0.02 * rng.normal(size=len(step))
        value = composed(manifold, smoother.values[f"v{k - 1}"], noisy)
        smoother.add_variable(f"v{k}", value, manifold)
        smoother.add_factor(bundle.BetweenFactor(f"v{k - 1}", f"v{k}", noisy, information))
        if k % 4 == 0:
            far = STARTS[manifold]
            for _ in range(3):
                far = composed(manifold, np.array(far), step)
            smoother.add_factor(
                bundle.BetweenFactor(f"v{k - 3}", f"v{k}", far, 2.0, loss=loss, loss_scale=0.1)
            )
        smoother.update()
    for _ in range(20):
        smoother.update()


@pytest.mark.parametrize("manifold", STARTS)
def test_the_estimate_is_that_of_a_batch(smoother, manifold):
    build(smoother, manifold)
    graph = smoother.graph
    batch = graph.solve(**EXACT)
    assert graph.cost() == pytest.approx(batch.summary.final_cost, rel=1e-7)
    assert batch.summary.final_cost > 1e-4
    for key, value in batch.values.items():
        sign = np.sign(value[:4] @ smoother.values[key][:4]) if manifold[-1] == "3" else 1
        found = np.array(smoother.values[key])
        if manifold in ("so3", "se3"):
            found[:4] *= sign
        if manifold in ("so2", "se2"):
            value = value.copy()
            value[-1] -= 2 * np.pi * np.round((value[-1] - found[-1]) / (2 * np.pi))
        np.testing.assert_allclose(found, value, atol=1e-4)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "tukey"])
def test_losses_are_those_of_a_batch(smoother, loss):
    build(smoother, "se2", loss=loss)
    graph = smoother.graph
    assert graph.cost() == pytest.approx(graph.solve(**EXACT).summary.final_cost, rel=1e-5)
    assert any(factor.loss == loss for factor in graph.factors)


def test_updates_say_what_they_cost(smoother):
    with pytest.raises(bundle.InputError, match="update"):
        smoother.statistics()
    build(smoother, "se2")
    found = smoother.statistics()
    assert 0 < found["p50_seconds"] <= found["p95_seconds"] <= found["max_seconds"]
    assert 0 < found["mean_share_reeliminated"] <= 1
    assert len(smoother.updates) == 12 + 20
    assert [u.num_variables for u in smoother.updates[:12]] == list(range(1, 13))
    first = smoother.updates[1]
    assert first.share_reeliminated == first.num_reeliminated / first.num_variables > 0
    assert "p95" in repr(smoother) and len(repr(smoother).splitlines()) < 12


def test_what_isam2_does_not_have_is_refused(smoother):
    with pytest.raises(bundle.InputError, match="variable"):
        smoother.update()
    smoother.add_variable("a", [0.0, 0, 0], "se2")
    for factor, word in (
        (bundle.FunctionFactor(["a"], lambda v: (v[0], [np.eye(3)])), "FunctionFactor"),
        (bundle.PriorFactor("a", [0, 0, 0], 1.0, loss="arctan"), "loss"),
        (bundle.PriorFactor("b", [0, 0, 0], 1.0), "b"),
        ("no factor", "factor"),
    ):
        with pytest.raises(bundle.InputError, match=word):
            smoother.add_factor(factor)
    with pytest.raises(bundle.InputError, match="a"):
        smoother.add_variable("a", [0.0, 0, 0], "se2")
    with pytest.raises(bundle.InputError, match="relinearize_threshold"):
        bundle.IncrementalSmoother(0.0)
    with pytest.raises(bundle.InputError, match="relinearize_skip"):
        bundle.IncrementalSmoother(relinearize_skip=0)


def test_a_variable_that_nothing_determines_is_named(smoother):
    for key in ("a", "b"):
        smoother.add_variable(key, [0.0, 0, 0], "se2")
    smoother.add_factor(bundle.BetweenFactor("a", "b", [1, 0, 0], 1.0))
    with pytest.raises(bundle.InputError, match=r"variable '[ab]'.*determine"):
        smoother.update()
    with pytest.raises(bundle.InputError, match="failed"):
        smoother.update()


def test_values_are_those_of_the_last_update(smoother):
    smoother.add_variable("a", [1.0, 2.0])
    smoother.add_factor(bundle.PriorFactor("a", [1.0, 3.0], 1.0))
    assert dict(smoother.values) == {}
    smoother.update()
    before = smoother.values
    smoother.add_variable("b", [0.0, 0.0])
    smoother.add_factor(bundle.BetweenFactor("a", "b", [1.0, 1.0], 1.0))
    assert list(before) == ["a"] and "b" not in smoother.values and len(before) == 1
    smoother.update()
    assert list(before) == ["a"] and list(smoother.values) == ["a", "b"]
    np.testing.assert_allclose(smoother.values["b"], [2.0, 4.0], atol=1e-12)
    with pytest.raises(KeyError):
        before["b"]
