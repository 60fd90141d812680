"""Initial poses: exact where the edges are, near where they are noisy."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.model import starts
from tests.graphs.pose_graphs import graphs

KINDS = ["odometry", "spanning_tree", "chordal"]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("init", KINDS)
def test_exact_edges_give_exact_poses(dimension, init):
    graph = graphs.loop(dimension, noise=0, start_noise=0)
    rng = np.random.default_rng(1)
    lost = [graphs.random_pose(rng, dimension) for _ in range(11)]
    start = graph.replace(poses=np.concatenate([graph.poses[:1], lost]))
    found = bundle.initial_poses(start, init)
    np.testing.assert_array_equal(found[0], graph.poses[0])
    for pose, truth in zip(found, graph.poses, strict=True):
        np.testing.assert_allclose(graphs.matrix(pose), graphs.matrix(truth), atol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("init", KINDS)
def test_a_fixed_pose_in_the_middle_and_ids_out_of_order(dimension, init):
    graph = graphs.loop(dimension, noise=0, start_noise=0)
    order = np.random.default_rng(4).permutation(12)
    place = np.argsort(order)
    fixed = order == 5
    mixed = graph.replace(
        poses=np.where(fixed[:, None], graph.poses[order], graph.poses[order][::-1]),
        edges=place[graph.edges],
        ids=order,
        fixed=fixed,
    )
    for pose, k in zip(bundle.initial_poses(mixed, init), order, strict=True):
        np.testing.assert_allclose(graphs.matrix(pose), graphs.matrix(graph.poses[k]), atol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
def test_chordal_is_near_the_optimum_where_the_file_is_far(dimension):
    graph = graphs.loop(dimension, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    results = {init: bundle.solve(graph, init=init) for init in ("chordal", "auto")}
    for result in results.values():
        assert result.summary.init == "chordal"
        assert result.summary.chi2_start < 3 * result.summary.chi2_final
    assert results["auto"].summary.init_choice and not results["chordal"].summary.init_choice
    spread = bundle.solve(graph, init="spanning_tree").summary
    assert results["chordal"].summary.chi2_start < spread.chi2_start


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_default_start_is_the_lower_of_chordal_and_file(dimension):
    graph = graphs.loop(dimension, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    far = bundle.solve(graph).summary
    chordal = bundle.pose_graph_chi2(graph.replace(poses=bundle.initial_poses(graph, "chordal")))
    assert far.init == "chordal" and far.init_choice
    np.testing.assert_allclose(far.chi2_start, chordal.sum(), rtol=1e-12)
    np.testing.assert_allclose(far.chi2_initial, bundle.pose_graph_chi2(graph).sum(), rtol=1e-12)
    near = bundle.solve(bundle.solve(graph).problem).summary
    assert near.init == "file" and not near.init_choice
    assert bundle.solve(graph, init="file").summary.init == "file"
    for loss in ("cauchy", "gnc_tls", "auto"):  # wrong closures deform the chordal start
        assert bundle.solve(graph, loss=loss).summary.init == "file"


@pytest.mark.parametrize("error", ["log", "g2o"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_errors_of_edges_are_those_at_start_and_end(dimension, error):
    """A solve passes them on instead of evaluating them again."""
    graph = graphs.loop(dimension, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    chordal = graph.replace(poses=bundle.initial_poses(graph, "chordal"))
    far = bundle.solve(graph, error=error)
    near = bundle.solve(far.problem, error=error, max_num_iterations=0)
    np.testing.assert_allclose(far.summary.chi2_start, bundle.pose_graph_chi2(chordal, error).sum())
    for result, start in ((far, graph), (near, far.problem)):
        np.testing.assert_array_equal(result.chi2_before, bundle.pose_graph_chi2(start, error))
        end = bundle.pose_graph_chi2(result.problem, error)
        np.testing.assert_allclose(result.chi2_after, end, rtol=1e-8)  # quaternions are normalised
    held, _, _ = _core.hold_poses(graph)
    options = bundle.PoseGraphOptions().asdict()
    flags = np.zeros(graph.num_edges, bool)
    with pytest.raises(bundle.InputError, match="chi2: expected a number for each edge"):
        _core.solve_pose_graph(graph, held, flags, options, None, None, False, far.chi2_after[1:])


def test_the_file_is_the_start_if_the_chordal_one_is_worse_or_does_not_exist(monkeypatch):
    graph = graphs.loop(2)
    real = _core.initial_poses
    moved = graph.poses + 1e3 * (np.arange(12) % 5)[:, None]
    monkeypatch.setattr(_core, "initial_poses", lambda *_given: moved)
    assert bundle.solve(graph).summary.init == "file"

    def singular(*_given):
        raise bundle.InputError("init: no solution")

    monkeypatch.setattr(_core, "initial_poses", singular)
    assert bundle.solve(graph).summary.init == "file"
    calls = []
    monkeypatch.setattr(_core, "initial_poses", lambda *g: calls.append(g[2]) or real(*g))
    bundle.solve(graph)
    assert calls == ["chordal"]
    bundle.solve(graph, loss="cauchy")  # costs with a loss need the poses; each kind once
    assert sorted(calls[1:]) == ["chordal", "odometry", "spanning_tree"]


@pytest.mark.parametrize("error", ["log", "g2o", "ceres"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_costs_of_starts_stop_at_the_limit(dimension, error):
    graph = graphs.loop(dimension, num_poses=400, num_closures=100, noise=0.1, seed=3)
    backwards = graph.replace(edges=graph.edges[::-1], measurements=graph.measurements[::-1])
    for given in (graph, backwards.replace(information=graph.information[::-1])):
        held, _, _ = _core.hold_poses(given)
        for init in ("odometry", "spanning_tree"):
            there = given.replace(poses=_core.initial_poses(given, held, init, 1))
            cost = 0.5 * bundle.pose_graph_chi2(there, error).sum()
            found = _core.start_cost(given, held, init, error, np.inf)
            np.testing.assert_allclose(found, cost, rtol=1e-9)
            assert 0.1 * cost < _core.start_cost(given, held, init, error, 0.1 * cost) <= found
    kept = ~(graph.edges == [5, 6]).all(axis=1)
    gap = graph.replace(
        edges=graph.edges[kept],
        measurements=graph.measurements[kept],
        information=graph.information[kept],
        edge_lines=graph.edge_lines[kept],
    )
    assert _core.start_cost(gap, held, "odometry", error, np.inf) == np.inf


@pytest.mark.parametrize("init", ["odometry", "spanning_tree"])
def test_a_start_below_the_end_of_the_default_start_is_named(init, monkeypatch):
    graph = graphs.loop(2, num_poses=20, num_closures=4, noise=0.05)
    end = bundle.solve(graph).summary.final_cost
    costs = {init: 0.9 * end}
    monkeypatch.setattr(_core, "start_cost", lambda *given: costs.get(given[2], np.inf))
    right = bundle.solve(graph).problem.poses
    real = _core.initial_poses
    monkeypatch.setattr(
        _core, "initial_poses", lambda *given: right if given[2] == init else real(*given)
    )
    far = bundle.solve(graph, max_num_iterations=1, init="lower").summary
    assert far.warning_kinds == ("better_start",) and init.split("_")[0] in far.warnings[0]
    for number in (2 * far.final_cost, 2 * end):
        assert f" {number:.4g}" in far.warnings[0]
    assert "{" not in far.warnings[0]


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_lower_start_ends_no_higher_than_the_file(dimension):
    for seed in range(12):
        graph = graphs.loop(
            dimension, num_poses=25, num_closures=8, noise=0.05, start_noise=0.4, seed=seed
        )
        ends = [bundle.solve(graph, init=init).summary.chi2_final for init in ("lower", "file")]
        assert ends[0] <= (1 + 1e-9) * ends[1], seed


def test_auto_keeps_poses_that_are_good():
    graph = bundle.solve(graphs.loop(2)).problem
    summary = bundle.solve(graph, init="auto").summary
    assert summary.init == "file" and summary.init_choice


@pytest.mark.parametrize("seed", [5, 7, 13, 15, 16])
def test_auto_ends_at_the_best_start(seed):
    """Few steps rank these starts wrongly, and trials without those of the solve do."""
    graph = graphs.manhattan_world(seed)
    inits = ("lower", "file", "chordal", "odometry", "spanning_tree")
    ends = {init: bundle.solve(graph, init=init).summary.chi2_final for init in inits}
    solved = bundle.solve(graph, init="auto")
    found = solved.summary
    same = bundle.solve(graph, init=found.init)
    np.testing.assert_array_equal(solved.iterations["cost"], same.iterations["cost"])
    assert found.chi2_final <= (1 + 1e-6) * min(ends.values())
    assert ends[found.init] == pytest.approx(found.chi2_final, rel=1e-9)
    assert max(ends.values()) > 1.01 * min(ends.values())
    for end in {ends[init] for init in inits[1:]}:
        assert f"{end:.4g} from" in found.init_choice


def test_auto_ends_at_the_best_start_of_a_public_graph(bundle_data):
    graph = bundle.load(bundle_data / "g2o/manhattan_b.g2o.bz2")
    found = bundle.solve(graph, init="auto").summary
    assert found.chi2_final == pytest.approx(2055.3787424, rel=1e-8)
    assert found.init == "chordal"


def test_auto_solves_to_the_end_only_where_starts_disagree(monkeypatch):
    real, steps = _core.solve_pose_graph, []

    def counted(*given, **named):
        steps.append(given[3]["max_num_iterations"])
        return real(*given, **named)

    monkeypatch.setattr(_core, "solve_pose_graph", counted)
    near = bundle.solve(graphs.loop(2, start_noise=0.01), init="auto")
    assert steps == [starts.FEW] * 4 + [100] and near.summary.init == "file"
    steps.clear()
    # here odometry is the file, and the tree another start: one solve for each end of few steps
    bundle.solve(graphs.manhattan_world(5), init="auto")
    assert steps == [starts.FEW] * 4 + [100] * (3 + 1)
    steps.clear()
    stopped = bundle.solve(graphs.manhattan_world(5), init="auto", max_num_iterations=3)
    assert steps == [3] * 5 and stopped.summary.termination_type == "NO_CONVERGENCE"


@pytest.mark.parametrize("loss", ["cauchy", "gnc_tls"])
def test_auto_compares_starts_with_the_loss_of_the_solve(loss):
    graph = graphs.manhattan_world(11)
    found = bundle.solve(graph, init="auto", loss=loss).summary
    assert found.init_choice and found.loss == loss
    if loss == "cauchy":
        ends = [
            bundle.solve(graph, init=init, loss=loss).summary.final_cost
            for init in ("file", "chordal", "odometry", "spanning_tree")
        ]
        assert found.final_cost <= (1 + 1e-6) * min(ends)


def test_chordal_weighs_edges_by_their_information():
    """The more certain of two contradictory edges counts."""
    graph = bundle.PoseGraph(
        poses=np.zeros((2, 3)),
        edges=[[0, 1], [1, 0]],
        measurements=[[1, 0, 0.3], [-3, 0, 0.5]],
        information=[1e8 * np.eye(3), np.eye(3)],
    )
    found = bundle.initial_poses(graph, "chordal")[1]
    np.testing.assert_allclose(found, [1, 0, 0.3], atol=1e-6)


def test_odometry_with_gaps_says_where():
    graph = graphs.loop(2)
    graph = graph.replace(ids=np.where(graph.ids > 6, graph.ids + 1, graph.ids))
    bundle.solve(graph, init="odometry")  # ids may leave numbers out
    cut = graph.replace(
        edges=np.delete(graph.edges, 6, 0),
        measurements=np.delete(graph.measurements, 6, 0),
        information=np.delete(graph.information, 6, 0),
        edge_lines=np.delete(graph.edge_lines, 6),
    )
    with pytest.raises(bundle.InputError, match=r"^init: expected an edge .* between 6 and 8"):
        bundle.solve(cut, init="odometry")


def test_an_end_above_the_chordal_start_is_said_to_be_a_local_minimum():
    graph = twisted()
    ends = {init: bundle.solve(graph, init=init).summary for init in ("file", "chordal")}
    assert ends["file"].chi2_final > 1.1 * ends["chordal"].chi2_start
    assert ends["file"].warning_kinds == ("local_minimum",)
    assert ends["chordal"].warning_kinds == ()
    right = bundle.solve(bundle.solve(graph, init="chordal").problem).summary
    assert right.init == "file" and right.warning_kinds == ()


def twisted():
    """A start from which the solve ends in a local minimum."""
    graph = graphs.loop(2, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    circle = np.linspace(0, 2 * np.pi, 31)[:-1]
    poses = np.stack([np.cos(3 * circle), np.sin(2 * circle), 5 * circle], axis=1)
    return graph.replace(poses=poses)


def test_an_end_that_has_not_converged_is_held_against_other_starts():
    stopped = bundle.solve(twisted(), init="file", max_num_iterations=2).summary
    assert stopped.termination_type == "NO_CONVERGENCE"
    assert stopped.warning_kinds == ("better_start",)
    assert "init auto" not in bundle.solve(twisted(), init="auto").summary.warnings
    robust = bundle.solve(twisted(), max_num_iterations=2, loss="cauchy").summary
    assert robust.warning_kinds == ("better_start",)
    assert bundle.solve(twisted(), init="file", max_num_iterations=0).summary.warning_kinds == ()


def test_after_a_slow_solve_other_starts_take_some_steps(monkeypatch):
    """Starts that are above the end themselves, and below it after few steps."""
    graph = twisted()
    end = bundle.solve(graph, init="file").summary.chi2_final
    far = {
        init: graph.poses + 1e3 * (np.arange(30) % 7)[:, None] * np.array([1, -1, 0])
        for init in ("odometry", "spanning_tree")
    }
    far["chordal"] = (
        bundle.solve(graph, init="chordal").problem.poses
        + np.array([1, 1, 0]) * (np.arange(30) % 2)[:, None]
    )
    real = _core.initial_poses
    monkeypatch.setattr(
        _core, "initial_poses", lambda g, held, init, n: far.get(init, real(g, held, init, n))
    )
    for poses in far.values():
        assert bundle.pose_graph_chi2(graph.replace(poses=poses)).sum() > end
    assert bundle.solve(graph, init="file").summary.warning_kinds == ()
    monkeypatch.setattr(starts, "SLOW", 2)
    slow = bundle.solve(graph, init="file").summary
    assert slow.warning_kinds == ("local_minimum",) and "from the chordal start" in slow.warnings[0]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_auto_ends_at_the_least_of_all_starts(dimension, seed):
    """Rings with one winding too many, at random: the file's poses are often the worst."""
    graph = graphs.loop(
        dimension, num_poses=20, num_closures=4, noise=0.15, start_noise=1.5, seed=seed
    )
    ends = {
        init: bundle.solve(graph, init=init).summary.chi2_final
        for init in ("file", "odometry", "spanning_tree", "chordal", "auto")
    }
    assert ends["auto"] <= (1 + 1e-6) * min(ends.values())


def test_auto_without_poses_and_without_a_chain():
    graph = graphs.loop(2).replace(has_poses=False)
    assert bundle.solve(graph, init="auto").summary.init in ("chordal", "odometry")
    apart = graph.replace(ids=2 * graph.ids, has_poses=True)
    for loss in ("trivial", "cauchy", "gnc_tls"):
        summary = bundle.solve(apart, init="auto", loss=loss).summary
        assert summary.init_choice.count("from") == 4  # consecutive among the ids there are
    cut = apart.replace(
        edges=apart.edges[5:],
        measurements=apart.measurements[5:],
        information=apart.information[5:],
        edge_lines=apart.edge_lines[5:],
    )
    assert "odometry" not in bundle.solve(cut, init="auto").summary.init_choice


def test_what_counts_is_where_more_steps_lead(monkeypatch):
    """And of equal ends the start that is there sooner."""
    graph = graphs.loop(2)
    held, _, _ = _core.hold_poses(graph)
    few = {"file": 10.0, "chordal": 12.0, "odometry": 11.0, "spanning_tree": 9.0}
    more = {"file": 5.0, "chordal": 4.0, "odometry": 4.0 + 1e-9, "spanning_tree": 9.0}

    def chosen():
        poses = starts._starts(graph, held, 1)

        def reached(_graph, there, _held, _doubted, _options, steps, _order):
            init = next(k for k in poses if (poses[k] == there).all())
            return few[init] if steps == starts.FEW else more[init]

        monkeypatch.setattr(starts, "_reached", reached)
        options = bundle.PoseGraphOptions(num_threads=1)
        return starts.choose_start(graph, held, graph.is_closure, options)

    found = chosen()
    assert found.init == "chordal" and "8 from the chordal start" in found.reason
    few["spanning_tree"] = more["spanning_tree"] = 4.0
    assert chosen().init == "spanning_tree"
    more["chordal"] = 4.0 * (1 - 2e-6)
    assert chosen().init == "chordal"
    few["chordal"] = 10.0 * (1 + 0.9e-6)  # as near as the file: not run again
    assert chosen().init == "spanning_tree"
    few["chordal"] = 10.0 * (1 + 1.1e-6)
    assert chosen().init == "chordal"


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_known_order_changes_no_bit(dimension):
    graph = graphs.loop(dimension, num_poses=40, num_closures=20, seed=3)
    held, _, _ = _core.hold_poses(graph)
    options = bundle.PoseGraphOptions(num_threads=1).asdict()
    none = np.zeros(graph.num_edges, bool)
    order = _core.order_poses(graph, held, "auto")
    solved = [
        _core.solve_pose_graph(graph, held, none, options, None, *given)["poses"]
        for given in ((), (order,))
    ]
    np.testing.assert_array_equal(*solved)
    poses = [_core.initial_poses(graph, held, "chordal", 1, *given) for given in ((), (order,))]
    np.testing.assert_allclose(*poses, atol=1e-9)
    with pytest.raises(RuntimeError, match="same free poses"):
        _core.solve_pose_graph(graph, ~held, none, options, None, order)


@pytest.mark.parametrize(("share", "is_lower"), [(0.5, False), (2.0, True)])
def test_a_gain_that_rounding_explains_is_none(share, is_lower):
    graph = graphs.loop(2)
    graph = graph.replace(poses=graph.poses + np.array([1e6, 0, 0]))
    size = np.abs(graph.poses).max()
    rounding = graph.information.trace(axis1=1, axis2=2).sum() * (starts.ROUNDING * size) ** 2
    assert starts._comparison(graph, share * rounding)({"odometry": 0.0}) == is_lower
    assert not starts._comparison(graph, share * rounding)({})
