"""Starts and optima of the field's data sets, as GTSAM and others reach them."""

import numpy as np
import pytest

import bundle

TARGETS = {
    "tinyGrid3D": (286.635747107, 18.6278188671, 6.72788161705, 18.5193664225),
    "smallGrid3D": (167788.666871, 1035.85066472, 458.153784343, 1025.39805564),
    "parking-garage": (16727.2038962, 1.26838479926, 1.23869057984, 1.26838633962),
    "sphere2500": (2611315.42361, 1351.40192585, 727.149667248, 1354.0169874),
    "intel": (553.995795564, 45.0042330881, 45.0046958106, 44.4178079807),
    "M3500": (2634712.54502, 137.914878247, 137.912950936, 137.912950936),
    "CSAIL": (2144300.25005, 40.5508833437, 40.5551288478, 61.1429730596),
}
SLOW_BY_CERES = ("parking-garage", "sphere2500", "M3500")


def load(bundle_data, name):
    return bundle.load(bundle_data / "g2o" / f"{name}.g2o.bz2")


@pytest.mark.parametrize("name", TARGETS)
def test_starts_and_optima(bundle_data, name):
    graph = load(bundle_data, name)
    start, log, g2o, ceres = TARGETS[name]
    result = bundle.solve(graph, init="file")
    np.testing.assert_allclose(result.summary.chi2_initial, start, rtol=1e-9)
    np.testing.assert_allclose(result.summary.chi2_final, log, rtol=1e-9)
    lower = bundle.solve(graph).summary
    assert lower.init == "chordal" and lower.chi2_start < start
    first = start if graph.has_poses else lower.chi2_start
    np.testing.assert_allclose(lower.chi2_initial, first, rtol=1e-9)
    assert lower.chi2_final <= (1 + 1e-9) * result.summary.chi2_final
    assert lower.num_linear_solves <= result.summary.num_linear_solves
    found = bundle.solve(graph, error="g2o").summary
    np.testing.assert_allclose(found.chi2_final, g2o, rtol=1e-9)
    found = bundle.solve(graph, error="ceres").summary
    np.testing.assert_allclose(found.chi2_final, ceres, rtol=1e-9)
    if name not in SLOW_BY_CERES:
        for error, expected in (("log", log), ("g2o", g2o), ("ceres", ceres)):
            found = bundle.solve(graph, error=error, backend="ceres").summary
            np.testing.assert_allclose(found.chi2_final, expected, rtol=1e-9)


@pytest.mark.parametrize("init", ["lower", "chordal", "auto"])
def test_mit_needs_a_chordal_start(bundle_data, init):
    graph = load(bundle_data, "MIT")
    result = bundle.solve(graph, init=init)
    np.testing.assert_allclose(result.summary.chi2_final, 41.2069470415, rtol=1e-9)
    assert result.summary.init in ("chordal", "spanning_tree")
    assert result.summary.warning_kinds == ()
    if init == "chordal":
        np.testing.assert_allclose(bundle.pose_graph_chi2(graph).sum(), 7097320711.04, rtol=1e-9)
        found = bundle.solve(graph, init=init, error="g2o", backend="ceres").summary
        np.testing.assert_allclose(found.chi2_final, 41.1632688362, rtol=1e-9)
        found = bundle.solve(graph, init=init, error="ceres").summary
        np.testing.assert_allclose(found.chi2_final, 39.6012944874, rtol=1e-9)


@pytest.mark.parametrize("name", [*TARGETS, "MIT"])
def test_auto_ends_at_the_best_of_all_starts(bundle_data, name):
    graph = load(bundle_data, name)
    best = 41.2069470415 if name == "MIT" else TARGETS[name][1]
    found = bundle.solve(graph, init="auto").summary
    np.testing.assert_allclose(found.chi2_final, best, rtol=1e-9)
    assert found.init_choice and found.warning_kinds == ()
