"""The alarm of a solve whose elimination order costs too much, and its record on disk."""

import json
import stat

import numpy as np
import pytest

import bundle
from bundle.graphs.factors import factor_graph
from bundle.interface import ordering_alarm
from bundle.interface.ordering_alarm import (
    MOST_ENTRIES,
    BestOrder,
    PastFactor,
    history_path,
    recall,
    with_ordering_alarm,
)
from tests.campaigns import orderings
from tests.campaigns.triage_inputs import chain_of_poses, graph_of


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def test_the_slow_solve_names_the_ordering_and_the_fast_one_is_silent():
    found = orderings.slow_and_fast(1500, 250)
    slow, fast = found["natural"], found["metis"]
    assert slow.warning_kinds == ("ordering",)
    assert "not the size" in slow.warnings[0] and "--pose-ordering" in slow.warnings[0]
    assert slow.final_cost == pytest.approx(fast.final_cost, rel=1e-9)
    assert slow.num_information_nonzeros == fast.num_information_nonzeros
    assert slow.least_factor_flops == found["auto"].factor_flops < slow.factor_flops / 20
    assert slow.least_flops_ordering == found["auto"].factor_ordering
    for order in ("metis", "amd", "auto"):
        assert found[order].warnings == ()
    assert found["auto"].least_factor_flops is None  # no look
    assert found["auto"].least_flops_ordering == ""


def test_healthy_inputs_are_silent():
    assert orderings.alarms(every=7) == []


def test_a_small_solve_is_not_looked_at(monkeypatch):
    order = bundle._core.order_poses

    def without_a_look(graph, held, ordering):
        assert ordering != "auto"
        return order(graph, held, ordering)

    monkeypatch.setattr(bundle._core, "order_poses", without_a_look)
    graph = chain_of_poses(0, 60, 8)
    assert bundle.solve(graph, ordering="natural", init="file").summary.warnings == ()


@pytest.mark.parametrize("solver", ["sparse_schur", "dense_schur"])
def test_cameras_first_is_named(solver):
    problem = bundle.synthesize(scene="orbit", num_images=12, num_points=300, seed=1).problem
    options = {"backend": "ceres", "linear_solver_type": solver, "max_num_iterations": 3}
    slow = bundle.solve(problem, linear_solver_ordering="cameras_first", **options).summary
    assert slow.warning_kinds == ("ordering",)
    assert slow.least_flops_ordering == "points first, amd"
    fast = bundle.solve(problem, **options).summary
    assert fast.warnings == ()
    assert slow.least_factor_flops <= fast.factor_flops


def test_the_bound_of_cameras_first_is_a_bound():
    """Dense: the exact flops of all points together are at least those of the largest image."""
    from bundle.interface.options import SolveOptions
    from bundle.solving.prepare import _least_flops

    problem = bundle.synthesize(scene="orbit", num_images=6, num_points=80, seed=1).problem
    bound = _least_flops(problem, SolveOptions())
    largest = 3 * int(np.bincount(problem.observation_image).max())
    assert bound == pytest.approx(sum(c * c + 3 * c for c in range(largest)))


FIELDS = {
    "num_linear_solves": 5, "factor_flops": 1e9, "num_factor_nonzeros": 40e5,
    "num_information_nonzeros": 1e5, "num_factor_columns": 900, "factor_ordering": "amd",
    "backend_used": "FUSED", "linear_solver_type_used": "SPARSE_NORMAL_CHOLESKY",
    "warnings": (), "warning_kinds": (),
}  # fmt: skip


def alarmed(flops, best=None, advice="", structure=0, **changes):
    look = None if best is None else (lambda: BestOrder(ordering="metis", flops=best, nonzeros=1e4))
    fields = {**FIELDS, "factor_flops": flops, **changes}
    found = with_ordering_alarm(fields, lambda: (np.array([structure]),), look, advice)
    assert len(found["warnings"]) == len(found["warning_kinds"])
    return found["warning_kinds"] == ("ordering",)


def test_thresholds():
    assert alarmed(2.1e9, 1e9, "x")
    assert not alarmed(1.9e9, 1e9, "x")
    assert not alarmed(2.1e9, 1e9), "an order that the solve chose"
    assert alarmed(3.1e9, 1e9, structure=1)
    assert not alarmed(2.1e6, 1e6, "x"), "too short to matter"
    assert not alarmed(1e9), "no look"


def test_less_than_the_linearisation_is_not_the_ordering():
    assert not alarmed(3.9e6, 1.95e6, "x", num_linear_solves=99)  # 19.5 flops an entry of Lambda
    assert alarmed(4.1e6, 2e6, "x", num_linear_solves=99)
    xy = np.array([[k // 2, k % 2] for k in range(8000)], float)
    edges = [(k, k + 1) for k in range(0, 8000, 2)] + [(k, k + 2) for k in range(7998)]
    ladder = graph_of(np.c_[xy, np.zeros(8000)], np.array(edges), np.random.default_rng(0), 0.02)
    settings = {"init": "file", "function_tolerance": 0.0, "max_num_iterations": 9}
    found = {order: bundle.solve(ladder, ordering=order, **settings).summary
             for order in ("amd", "metis")}  # fmt: skip
    more = found["metis"].factor_flops - found["amd"].factor_flops
    assert more * found["metis"].num_linear_solves > ordering_alarm.LEAST_FLOPS
    assert found["metis"].factor_flops > 2 * found["metis"].least_factor_flops
    assert "ordering" not in found["metis"].warning_kinds


def test_growth_at_the_same_structure_is_named_and_another_size_is_not():
    assert not alarmed(1e9, factor_ordering="metis")
    assert not alarmed(1.5e9)
    assert alarmed(2.1e9)
    assert alarmed(2.1e9), "the cheapest solve is kept, not the last"
    assert not alarmed(9e9, num_information_nonzeros=3e5), "size"
    assert not alarmed(9e9, structure=1), "another structure"
    assert not alarmed(9e9, linear_solver_type_used="SPARSE_SCHUR"), "another solver"
    assert not alarmed(9e9, backend_used="CERES")
    assert not alarmed(9e9, factor_ordering="metis"), "equal orders have equal factors"


def test_growth_of_a_real_graph(cache):
    graph = chain_of_poses(0, 1500, 250)
    bundle.solve(graph, ordering="metis", max_num_iterations=60, function_tolerance=0)
    del cache
    again = bundle.solve(graph, ordering="natural").summary
    assert again.warning_kinds == ("ordering",)  # one sentence, although both signs hold


def test_factor_graphs_are_compared_with_metis(monkeypatch):
    monkeypatch.setattr(factor_graph, "LEAST_FLOPS", 1.0)
    monkeypatch.setattr(ordering_alarm, "LEAST_FLOPS", 1.0)
    monkeypatch.setattr(ordering_alarm, "LEAST_FLOPS_OF_ENTRY", 0.0)
    graph = orderings.factors(chain_of_poses(0, 200, 30))
    found = graph.solve().summary
    assert found.warning_kinds == ()
    inspected = bundle.inspect(graph)
    costs = {cost.ordering: cost for cost in inspected.costs}
    assert found.factor_flops == costs["amd"].flops
    assert found.num_factor_nonzeros == costs["amd"].nnz_factor
    assert found.num_information_nonzeros == inspected.nnz_free
    assert found.num_reduced_nonzeros == inspected.nnz_free
    assert found.num_factor_columns == 3 * inspected.num_free_poses
    assert found.least_factor_flops == min(costs[name].flops for name in ("amd", "metis"))
    cheap = BestOrder(ordering="metis", flops=1.0, nonzeros=1.0)
    count = factor_graph._count
    monkeypatch.setattr(
        factor_graph, "_count", lambda p, name: cheap if name == "metis" else count(p, name)
    )
    assert graph.solve().summary.warning_kinds == ("ordering",)
    assert graph.solve(linear_solver_type="dense_qr").summary.warning_kinds == ()


def test_dense_factor_graphs_have_counts():
    walk = chain_of_poses(0, 20, 4)
    found = orderings.factors(walk).solve().summary
    n = 3 * 19
    assert found.linear_solver_type_used == "DENSE_NORMAL_CHOLESKY"
    assert found.num_factor_nonzeros == n * (n + 1) // 2
    assert found.factor_flops == sum(c * c + 3 * c for c in range(n))


def test_the_record_is_private_bounded_and_small():
    past = PastFactor(1e9, 1e6, "amd")
    for k in range(MOST_ENTRIES + 20):
        assert recall(f"{k:016x} FUSED SPARSE_NORMAL_CHOLESKY 5181 60741", past) is None
    path = history_path()
    assert len(json.loads(path.read_text().splitlines()[1])) == MOST_ENTRIES
    assert path.stat().st_size < 30_000
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert list(path.parent.iterdir()) == [path]  # no partial files
    assert recall(f"{MOST_ENTRIES + 19:016x} FUSED SPARSE_NORMAL_CHOLESKY 5181 60741", past) == past


@pytest.mark.parametrize("content", [b"", b"\x00", b"\xff\n{}", b"1\n2\n3\n", b"00000000\n{}\n"])
def test_a_damaged_record_counts_as_empty(content):
    history_path().parent.mkdir(parents=True)
    history_path().write_bytes(content)
    assert recall("a", PastFactor(1e9, 1e6, "amd")) is None
    assert recall("a", PastFactor(2e9, 1e6, "amd")) == PastFactor(1e9, 1e6, "amd")


@pytest.mark.parametrize(("old", "new"), [("1000000000.0", "1000.0"), ("amd", "no"), ('"a"', "a")])
def test_an_edited_record_counts_as_empty(old, new):
    recall("a", PastFactor(1e9, 1e6, "amd"))
    text = history_path().read_text()
    assert old in text
    history_path().write_text(text.replace(old, new))
    assert recall("a", PastFactor(2e9, 1e6, "amd")) is None


def test_the_record_of_another_machine_is_read(cache, monkeypatch):
    recall("a", PastFactor(1e9, 1e6, "amd"))
    text = history_path().read_bytes()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache / "other"))
    history_path().parent.mkdir(parents=True)
    history_path().write_bytes(text)
    assert recall("a", PastFactor(2e9, 1e6, "amd")) == PastFactor(1e9, 1e6, "amd")


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert recall("a", PastFactor(1e9, 1e6, "amd")) is None


def test_a_user_without_a_home_has_no_record(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(ordering_alarm, "cache_folder", homeless)
    assert recall("a", PastFactor(1e9, 1e6, "amd")) is None
