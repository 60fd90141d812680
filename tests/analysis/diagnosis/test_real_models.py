"""Reference numbers of real models."""

import pytest

import bundle


@pytest.fixture(scope="module")
def brighton(bundle_data):
    solved = bundle.solve(
        bundle_data / "georeferenced/brighton_gps/model", function_tolerance=1e-12
    )
    return bundle.diagnose(solved)


def test_a_flat_scene_is_named(brighton):
    assert (brighton.nullity, brighton.expected_nullity) == (7, 7)
    assert brighton.eigenvalues[0] == pytest.approx(3.52e-6, rel=5e-3)
    assert brighton.condition_number == pytest.approx(1.6e6, rel=0.05)
    assert (brighton.digits_normal_equations, brighton.digits_square_root) == (10, 13)
    (mode,) = brighton.weak_modes
    assert mode.kind == "flat_scene"
    assert mode.camera_ids == (1,)
    assert len(mode.image_ids) == 18
    assert "ocal length" in mode.sentence and "height" in mode.sentence


@pytest.mark.parametrize(
    ("name", "eigenvalue", "condition"),
    [("maupertuis", 6.30e-4, 8.9e3), ("crane_mast", 5.50e-4, 1.0e4)],
)
def test_spectrum_of_a_converged_model(bundle_data, name, eigenvalue, condition):
    solved = bundle.solve(bundle_data / f"colmap/{name}", function_tolerance=1e-12)
    found = bundle.diagnose(solved)
    assert (found.nullity, found.expected_nullity) == (7, 7)
    assert found.max_null_eigenvalue < 4.7e-13
    assert found.eigenvalues[0] == pytest.approx(eigenvalue, rel=2e-3)
    assert found.condition_number == pytest.approx(condition, rel=0.05)
    assert found.ok


def test_a_metric_rig_has_six_degrees(bundle_data):
    found = bundle.diagnose(bundle_data / "rigs/kitti26_stereo_rig")
    assert (found.nullity, found.expected_nullity) == (6, 6)
    assert {mode.kind for mode in found.weak_modes} == {"forward_motion"}


def test_points_without_parallax_are_named(bundle_data):
    found = bundle.diagnose(bundle_data / "colmap/video48")
    assert sorted(found.points_without_parallax.tolist()) == [1562, 1604, 1611, 1779]
    assert (found.nullity, found.expected_nullity) == (7, 7)


def test_a_collapsed_cluster_is_named(bundle_data):
    found = bundle.diagnose(bundle_data / "degenerate/pratikk0")
    (cluster,) = found.collapsed
    assert len(cluster.point_ids) == 1354
    assert cluster.num_observations == 15341
    assert found.expected_nullity == 7
    assert not found.ok
    assert "collapsed_scale" in {mode.kind for mode in found.weak_modes}
    assert found.rank_gap < 10  # rounding has eaten the gap: the count of null directions is vague
    assert "unclear_rank" in {finding.kind for finding in found.findings}
