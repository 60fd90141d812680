"""Planted graphs on both sides of each threshold of certificates, with exact numbers."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.graphs.pose_graphs import certify as certify_module
from bundle.graphs.pose_graphs.certify import bound_weights, chordal_weights
from tests.graphs.pose_graphs.chordal_oracle import chordal_cost, ring
from tests.graphs.pose_graphs.graphs import error_by_matrices, pose_of


def pair(x, y, *, across=0.0, error=1.0):
    """Return two poses, and two edges that disagree by twice `error` along x.

    The information is x and y on the translation, and 2 on the rotation, so that kappa is 1 and tau
    (x + y) / 2. The second pose is `across` beside the minimum. So chi2 is 2 (x error^2 + y
    across^2), and F is 2 tau (error^2 + across^2).
    """
    return bundle.PoseGraph(
        poses=np.array([[0, 0, 0], [5, across, 0]], float),
        edges=[[0, 1], [0, 1]],
        measurements=np.array([[5 + error, 0, 0], [5 - error, 0, 0]], float),
        information=np.tile(np.diag([x, y, 2.0]), (2, 1, 1)),
    )


def test_a_pair_has_the_numbers_of_its_formula():
    found = bundle.certify(pair(100.0, 1.0, across=0.5))
    assert found.chi2 == pytest.approx(2 * (100 + 0.25))
    assert found.initial_cost == pytest.approx(2 * 50.5 * 1.25)
    assert found.cost == pytest.approx(2 * 50.5)


@pytest.mark.parametrize(("share", "is_near"), [(0.0999, True), (0.1001, False)])
def test_near_a_minimum_of_the_chordal_cost(share, is_near):
    """Isotropic information: F and chi2 are above their minima by the same share."""
    found = bundle.certify(pair(1.0, 1.0, across=np.sqrt(share)))
    assert found.initial_cost / found.cost == pytest.approx(1 + share)
    assert found.is_settled == is_near
    assert found.verdict == ("certified" if is_near else "not-a-minimum")


@pytest.mark.parametrize(("share", "is_near"), [(0.00999, True), (0.01001, False)])
def test_near_a_minimum_of_chi2(share, is_near):
    """F is 1 / 100 and more above its minimum, chi2 by the share."""
    across = np.sqrt(1000 * share / (1 - share))
    found = bundle.certify(pair(1000.0, 1.0, across=across))
    assert found.initial_cost > 5 * found.cost
    assert found.is_settled == is_near
    assert found.verdict == ("certified" if is_near else "not-a-minimum")


@pytest.mark.parametrize(("share", "is_near"), [(0.99, True), (1.02, False)])
def test_exact_measurements(share, is_near):
    """F of 1e-9 kappa per edge is zero."""
    across = np.sqrt(share * 1e-9)
    found = bundle.certify(pair(1.0, 1.0, across=across, error=0.0))
    assert found.initial_cost == pytest.approx(share * 2e-9, rel=1e-6)
    assert found.verdict == ("certified" if is_near else "not-a-minimum")


@pytest.mark.parametrize(("off", "is_isotropic"), [(0.9e-9, True), (1.1e-9, False)])
def test_isotropic_information(off, is_isotropic):
    for x, y in ((1.0, 1 + 2 * off), (1 + 2 * off, 1.0)):
        assert bundle.certify(pair(x, y)).is_isotropic == is_isotropic


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("error", ["log", "g2o", "ceres"])
def test_the_bound_of_correlated_information_is_tight(dimension, error):
    """The residual is along the direction in which the weights of the bound equal the information.

    Any larger weights would give a bound above chi2.
    """
    rng = np.random.default_rng(dimension)
    d = 3 if dimension == 2 else 6
    turn, shift = (slice(2, 3), slice(0, 2)) if dimension == 2 else (slice(0, 3), slice(3, 6))
    root = rng.normal(size=(d, d))
    omega = root @ root.T + 0.1 * np.eye(d)
    a, b = (np.linalg.eigvalsh(omega[part, part])[0] for part in (turn, shift))
    scales = np.empty(d)
    scales[turn], scales[shift] = a**-0.5, b**-0.5
    values, vectors = np.linalg.eigh(omega * np.outer(scales, scales))
    assert values[0] < 0.9  # blocks are coupled
    half = 2.0 if error == "g2o" and dimension == 3 else 1.0
    step = 1e-4 * scales * vectors[:, 0]
    there = np.eye(dimension + 1)
    there[:dimension, dimension] = step[shift]
    angles = half * step[turn]
    if dimension == 2:
        there[:2, :2] += angles[0] * np.array([[0, -1], [1, 0]])
        pose = pose_of(there)
    else:
        pose = np.concatenate([angles / 2, [1.0], step[shift]])
        pose[:4] /= np.linalg.norm(pose[:4])
    still = np.zeros(3) if dimension == 2 else np.array([0, 0, 0, 1.0, 0, 0, 0])
    sign = -1.0 if error == "ceres" and dimension == 3 else 1.0
    residual = error_by_matrices(error, still, pose, still)
    residual[turn] *= sign  # q_Z q_B^-1 has the opposite sense
    flip = np.ones(d)
    flip[turn] = sign
    graph = bundle.PoseGraph(
        poses=np.array([still, pose]),
        edges=[[0, 1]],
        measurements=still[None],
        information=(omega * np.outer(flip, flip))[None],
    )
    weights = bound_weights(graph, error)
    assert weights.kappa == pytest.approx(0.5 / half**2 * values[0] * a, rel=1e-12)
    assert weights.tau == pytest.approx(values[0] * b, rel=1e-12)
    chi2 = float(bundle.pose_graph_chi2(graph, error).sum())
    assert chi2 == pytest.approx(residual @ omega @ residual, rel=1e-9)
    assert chordal_cost(graph, weights.kappa, weights.tau) == pytest.approx(chi2, rel=1e-3)
    loose = bundle.certify(graph, error=error)
    assert not loose.is_isotropic
    singular = np.array(graph.information)
    singular[0, shift] = singular[0, :, shift] = 0
    assert bound_weights(graph.replace(information=singular), error) is None


def test_rounding_raises_no_weights_of_a_bound():
    """Uncoupled blocks with eigenvalues of 1 to 1e10: alpha is 1, computed up to 1e-6 above."""
    rng = np.random.default_rng(0)
    information = np.zeros((40, 6, 6))
    for matrix in information:
        for part in (slice(0, 3), slice(3, 6)):
            axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            block = axes * [1.0, 1e5, 1e10] @ axes.T
            matrix[part, part] = (block + block.T) / 2
    still = np.array([[0, 0, 0, 1.0, 0, 0, 0]])
    graph = bundle.PoseGraph(
        poses=np.repeat(still, 2, axis=0),
        edges=[[0, 1]] * 40,
        measurements=np.repeat(still, 40, axis=0),
        information=information,
    )
    weights = bound_weights(graph, "log")
    least = [np.linalg.eigvalsh(information[:, k : k + 3, k : k + 3])[:, 0] for k in (0, 3)]
    assert (weights.kappa <= 0.5 * least[0]).all() and (weights.tau <= least[1]).all()
    assert weights.tau == pytest.approx(least[1], rel=1e-4)


def test_singular_information_has_no_bound_and_no_harmonic_weights():
    edge = {"edges": [[0, 1]], "poses": np.zeros((2, 3)), "measurements": np.zeros((1, 3))}
    coupled = np.array([[1.0, 0, 1], [0, 1, 0], [1, 0, 1]])  # its blocks are regular
    graph = bundle.PoseGraph(information=[coupled], **edge)
    assert bound_weights(graph, "log") is None
    assert np.isnan(bundle.certify(graph).chi2_lower_bound)
    still = np.array([[0, 0, 0, 1.0, 0, 0, 0]])
    flat = bundle.PoseGraph(
        poses=np.repeat(still, 2, axis=0),
        edges=[[0, 1]],
        measurements=still,
        information=[np.diag([1.0, 1, 0, 1, 1, 1])],
    )
    assert chordal_weights(flat, "mean", "log").kappa == pytest.approx(1 / 3)
    with pytest.raises(bundle.InputError, match="weights above 0 on rotation and translation"):
        chordal_weights(flat, "se-sync", "log")
    for part in (slice(0, 3), slice(3, 6)):
        nothing = np.array(flat.information)
        nothing[0, part, part] = 0
        with pytest.raises(bundle.InputError, match="weights above 0"):
            chordal_weights(flat.replace(information=nothing), "mean", "log")


@pytest.mark.parametrize("weights", ["mean", "se-sync"])
def test_weights_of_known_information(weights):
    """Means, and d / tr(Omega^-1): 3 and 12 / 7 for 1 2 6 and 1.8 for 1 2 6; in the plane I33."""
    edge = {"edges": [[0, 1]], "poses": np.zeros((2, 3)), "measurements": np.zeros((1, 3))}
    flat = bundle.PoseGraph(information=[np.diag([1.0, 4.0, 10.0])], **edge)
    found = chordal_weights(flat, weights, "log")
    expected = (5.0, 2.5) if weights == "mean" else (10.0, 1.6)
    assert (found.kappa[0], found.tau[0]) == pytest.approx(expected)
    still = np.array([[0, 0, 0, 1.0, 0, 0, 0]])
    space = bundle.PoseGraph(
        poses=np.repeat(still, 2, axis=0),
        edges=[[0, 1]],
        measurements=still,
        information=[np.diag([1.0, 2.0, 6.0, 1.0, 4.0, 10.0])],
    )
    for error, per_omega in (("log", 0.5), ("ceres", 0.5), ("g2o", 0.125)):
        found = chordal_weights(space, weights, error)
        expected = (per_omega * 3, 5.0) if weights == "mean" else (0.9, 3 / 1.35)
        assert (found.kappa[0], found.tau[0]) == pytest.approx(expected)


@pytest.mark.parametrize("dimension", [2, 3])
def test_edges_that_were_left_out_have_no_part_in_the_certificate(dimension):
    pytest.importorskip("scipy")
    right = ring(np.random.default_rng(1), 12, dimension, noise=0.01, chords=6)
    wrong = np.array(right.measurements)
    closure = int(np.flatnonzero(right.is_closure)[-1])
    wrong[closure, : 2 if dimension == 2 else None] += 3.0
    graph = right.replace(measurements=wrong)
    solved = bundle.solve(graph, consistency=True, certify=True, information="file")
    assert [entry.edge for entry in solved.left_out] == [closure]
    found = solved.certificate
    assert found.problem.num_edges == graph.num_edges - 1
    assert found.chi2 == pytest.approx(solved.summary.chi2_final, rel=1e-9)
    assert found.verdict == "certified"
    # "before" is that of the given poses, for all edges, although the solve began elsewhere
    far = graph.replace(poses=bundle.initial_poses(graph, "odometry"))
    moved = bundle.solve(far, consistency=True, init="chordal")
    before = bundle.pose_graph_chi2(far)
    np.testing.assert_allclose(moved.chi2_before, before, rtol=1e-9, atol=1e-12)
    kept = np.delete(before, closure).sum()
    assert moved.summary.chi2_initial == pytest.approx(kept, rel=1e-9)
    alone = bundle.certify(solved)
    assert alone.cost == pytest.approx(found.cost, rel=1e-9)
    # chi2 of all edges includes the wrong one
    assert bundle.certify(solved.problem).chi2 > 2 * found.chi2


def test_interrupted_and_unusable_solves_have_no_certificate():
    graph = ring(np.random.default_rng(0), 30, 2, noise=0.1)
    calls = []

    def stop(record):
        calls.append(record)
        if len(calls) == 2:
            raise KeyboardInterrupt

    stopped = bundle.solve(graph, init="file", certify=True, progress=stop)
    assert stopped.summary.interrupted and stopped.certificate is None and len(calls) == 2
    huge = np.array(graph.measurements)
    huge[3, :2] = 1e160
    failed = bundle.solve(graph.replace(measurements=huge), init="file", certify=True)
    assert not failed.summary.is_solution_usable and failed.certificate is None


def test_ctrl_c_during_a_certificate_keeps_the_solution():
    graph = ring(np.random.default_rng(0), 30, 2, turns=1, noise=0.02)
    plain = bundle.solve(graph, init="file")
    count = len(plain.iterations["cost"])
    calls = []

    def stop(record):
        calls.append(record)
        if len(calls) > count:
            raise KeyboardInterrupt

    found = bundle.solve(graph, init="file", certify=True, progress=stop)
    assert found.summary.interrupted and found.certificate is None
    np.testing.assert_array_equal(found.problem.poses, plain.problem.poses)
    assert found.summary.is_solution_usable and found.options.certify
    with pytest.raises(KeyboardInterrupt):
        bundle.certify(plain, progress=stop)
    with pytest.raises(ZeroDivisionError):
        bundle.certify(plain, progress=lambda step: 1 / (step["iteration"] * 0))


def test_progress_has_each_step_of_newtons_method():
    graph = bundle.solve(ring(np.random.default_rng(0), 30, 2, turns=1, noise=0.02), init="file")
    steps = []
    found = bundle.certify(graph, max_rank=0, progress=steps.append)
    assert [step["iteration"] for step in steps] == list(range(1, found.num_steps + 1))
    assert steps[-1]["cost"] == pytest.approx(found.cost, rel=1e-12)
    assert sum(step["cost_change"] for step in steps) < found.initial_cost - found.cost + 1e-9
    more = []
    bundle.certify(graph, progress=more.append)
    assert len(more) > len(steps)  # those of the staircase


@pytest.mark.parametrize(
    ("gain", "is_usable", "is_interrupted", "takes_second"),
    [
        (0.99e-6, True, False, False),
        (1.01e-6, True, False, True),
        (0.5, False, False, False),
        (0.5, True, True, False),
    ],
)
def test_a_second_solve_must_end_lower(gain, is_usable, is_interrupted, takes_second):
    """The staircase's poses are lower; the solve from there ends lower by a known share."""
    graph = ring(np.random.default_rng(0), 20, 2, turns=1, noise=0.02)
    real = bundle.solve(graph, init="file")
    solves = []

    def solve(given, options):
        solves.append(given)
        is_first = len(solves) == 1
        cost = real.summary.final_cost * (1 if is_first else 1 - gain)
        summary = dataclasses.replace(real.summary, final_cost=cost, chi2_initial=len(solves))
        if not is_first:
            ends = {"is_solution_usable": is_usable, "interrupted": is_interrupted}
            summary = dataclasses.replace(summary, **ends)
        before = real.chi2_before + len(solves)
        return dataclasses.replace(real, summary=summary, options=options, chi2_before=before)

    options = bundle.PoseGraphOptions(certify=True, num_threads=1)
    found = certify_module.certified(graph, options, solve)
    assert len(solves) == 2
    np.testing.assert_array_equal(solves[1].poses, found.certificate.staircase.problem.poses)
    assert (found.summary.init == "staircase") == takes_second
    assert found.certificate.verdict == "not-certified"
    assert found.certificate.staircase.verdict == "certified"
    assert found.initial_problem is (graph if takes_second else real.initial_problem)
    # chi2 "before" stays that of the given poses
    np.testing.assert_array_equal(found.chi2_before, real.chi2_before + 1)
    assert found.summary.chi2_initial == 1


def turned_pair(a, b, angle):
    """Return two poses at an angle, and edges that measure 0 (weight a) and 2.5 rad (weight b).

    F is one sinusoid: a minimum and a maximum. chi2 wraps, and has two minima.
    """
    return bundle.PoseGraph(
        poses=np.array([[0, 0, 0], [0, 0, angle]], float),
        edges=[[0, 1], [0, 1]],
        measurements=np.array([[0, 0, 0], [0, 0, 2.5]], float),
        information=np.array([np.diag([1.0, 1.0, a]), np.diag([1.0, 1.0, b])]),
    )


def test_a_minimum_of_chi2_without_one_of_the_chordal_cost():
    """The minimum of F belongs to the other minimum of chi2, which a certified solve then takes."""
    far, near = 0.8 * (2.5 - 2 * np.pi) / 1.8, 0.8 * 2.5 / 1.8
    graph = turned_pair(1.0, 0.8, far)
    found = bundle.certify(graph)
    assert (found.verdict, found.is_settled) == ("not-a-minimum", True)
    assert found.chi2 == pytest.approx(far**2 + 0.8 * (far - 2.5 + 2 * np.pi) ** 2)
    phasor = 1 + 0.8 * np.exp(2.5j)
    assert found.problem.poses[1, 2] == pytest.approx(np.angle(phasor))
    assert found.cost == pytest.approx(2 * (1.8 - abs(phasor)))
    optimum = near**2 + 0.8 * (near - 2.5) ** 2
    for start, init in ((graph, "chordal_minimum"), (turned_pair(1.0, 0.8, near), "file")):
        solved = bundle.solve(start, init="file", certify=True)
        assert solved.summary.init == init
        assert solved.summary.chi2_final == pytest.approx(optimum, rel=1e-9)
        chi2 = bundle.pose_graph_chi2(start).sum()
        assert solved.summary.chi2_initial == pytest.approx(chi2, rel=1e-9)
    assert bundle.certify(turned_pair(1.0, 0.8, near)).verdict == "certified"
    # a step away from the minimum of chi2, a solve is not finished
    assert not bundle.certify(turned_pair(1.0, 0.8, far + 0.3)).is_settled


@pytest.mark.parametrize(("apart", "verdict"), [(0.9e-6, "certified"), (1.1e-6, "not-a-minimum")])
def test_minima_of_equal_chi2_are_the_same(apart, verdict):
    """Measurements 0 and pi - delta: the minima of chi2 are as (pi - delta)^2 to (pi + delta)^2."""
    delta = np.pi / 4 * apart
    graph = turned_pair(1.0, 0.5, -(np.pi + delta) / 3)
    graph = graph.replace(measurements=np.array([[0, 0, 0], [0, 0, np.pi - delta]]))
    found = bundle.certify(graph)
    assert found.chi2 == pytest.approx((np.pi + delta) ** 2 / 3, rel=1e-12)
    assert found.initial_cost > 1.2 * found.cost  # the minimum of F belongs to the other one
    assert (found.verdict, found.is_settled) == (verdict, True)


def test_a_maximum_of_the_chordal_cost_is_no_minimum():
    found = bundle.certify(turned_pair(1.0, 1.0, 1.25 - np.pi))
    assert found.num_steps <= 1 and found.cost == pytest.approx(found.initial_cost)
    assert (found.verdict, found.is_settled) == ("not-a-minimum", True)


def test_a_bound_of_chi2_without_certificate_is_below_the_optimum():
    """Anisotropic information, and poses of a ring wound once more."""
    right, wound = (ring(np.random.default_rng(2), 14, 2, turns=k, noise=0.02) for k in (0, 1))
    information = right.information * np.array([1.0, 1.4, 1.0])[:, None]
    graphs = [graph.replace(information=information) for graph in (right, wound)]
    optimum, local = (bundle.solve(graph, init="file") for graph in graphs)
    assert local.summary.chi2_final > 2 * optimum.summary.chi2_final
    for max_rank in (0, 4):
        found = bundle.certify(local, max_rank=max_rank)
        assert found.verdict == "not-certified" and not found.is_isotropic
        assert found.chi2_lower_bound <= optimum.summary.chi2_final
        if max_rank == 0:  # the bound of F is negative, that of a sum of squares is not
            assert found.lower_bound < found.chi2_lower_bound == 0
    assert found.chi2_lower_bound > 0.5 * optimum.summary.chi2_final


def test_rounding_makes_no_gap_negative():
    found = bundle.certify(pair(1.0, 1.0))
    for bound, gap in ((2.0 - 0.25, 0.25), (2.0 + 1e-15, 0.0)):
        other = dataclasses.replace(found, chi2=2.0, chi2_lower_bound=bound)
        assert other.chi2_gap == gap
        assert dataclasses.replace(found, cost=2.0, lower_bound=bound).gap == gap


def test_no_second_solve_without_lower_poses():
    """With large noise the relaxation is loose: no certificate, and nothing lower."""
    graph = ring(np.random.default_rng(4), 8, 3, noise=0.9, chords=4)
    real = bundle.solve(graph, max_num_iterations=500)
    solves = []

    def solve(given, options):
        solves.append(given)
        return dataclasses.replace(real, options=options)

    options = bundle.PoseGraphOptions(certify=True, num_threads=1)
    found = certify_module.certified(graph, options, solve)
    stairs = found.certificate.staircase
    assert stairs.cost >= (1 - 1e-6) * found.certificate.cost
    assert 0 < stairs.lower_bound < stairs.cost
    assert stairs.gap == pytest.approx(stairs.cost - stairs.lower_bound, rel=1e-12)
    assert stairs.verdict == "not-certified"
    # The relaxation is solved: its cost is the best bound, above those at poses.
    assert stairs.lower_bound == pytest.approx(stairs.relaxed_cost, rel=1e-6)
    assert stairs.lower_bound > 2 * found.certificate.lower_bound
    assert len(solves) == 1 and found.summary.init == real.summary.init
