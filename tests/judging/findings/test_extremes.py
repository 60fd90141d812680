"""Findings of models of every shape: tiny, exact, huge, broken, rigs, fisheye, BAL."""

import numpy as np
import pytest

import bundle
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import MOST_OBSERVATIONS
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem


def kinds(problem, **more):
    return {finding.kind for finding in find(problem, **more)}


@pytest.fixture(scope="module")
def sound():
    made = bundle.synthesize(scene="orbit", num_images=12, num_points=600, seed=1)
    return bundle.solve(made.problem).problem


def test_an_empty_model_has_no_findings(sound):
    assert find(sound.select(observations=np.zeros(0, int)).problem) == ()


@pytest.mark.parametrize("count", [1, 2, 5, 29, 31])
def test_few_observations(sound, count):
    find(sound.select(observations=np.arange(count)).problem)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_images(sound, count):
    part = sound.select(images=np.arange(count)).problem
    assert not kinds(part) & {"motion", "image_residuals", "weak_joint", "lens_model", "outliers"}


def test_exact_observations_have_no_findings():
    made = bundle.synthesize(scene="orbit", num_images=12, num_points=600, pixel_noise=0.0, seed=1)
    assert kinds(made.ground_truth) == set()
    rounded = made.ground_truth.replace(observation_xy=made.ground_truth.observation_xy + 1e-7)
    assert kinds(rounded) == set()


@pytest.mark.parametrize("value", [1e9, 1e200, 1e308])
@pytest.mark.parametrize("name", ["points", "cam_from_world", "camera_params", "observation_xy"])
def test_one_huge_value_is_blamed_on_nothing_else(sound, name, value):
    """The first point, image, lens or observation is broken; all else is sound."""
    array = getattr(sound, name).copy()
    array[0, -1] = value
    found = find(sound.replace(**{name: array}))
    assert not {one.kind for one in found} & {"motion", "weak_joint", "lens_model", "shared_lens"}
    for one in found:
        assert one.sentence and "nan" not in one.sentence.lower()
        numbers = [item for item in one.evidence.values() if isinstance(item, float)]
        assert np.isfinite(numbers).all()
        if one.kind == "image_residuals":
            assert sound.image_names[0] in one.sentence
            assert sound.image_names[1] not in one.sentence
    if name in ("points", "observation_xy"):  # one track of hundreds
        assert found == ()


def test_a_sample_finds_what_the_whole_finds():
    made = bundle.synthesize(
        scene="orbit", num_images=20, num_points=45_000, mean_track_length=5,
        outlier_share=0.03, seed=2,
    )  # fmt: skip
    assert made.ground_truth.num_observations > MOST_OBSERVATIONS
    found = {finding.kind: finding for finding in find(made.ground_truth)}
    assert set(found) == {"outliers"}
    # At the border of the images, where outliers are the majority, they pass for the noise.
    assert 0.02 < found["outliers"].evidence["share"] < 0.031


@pytest.mark.parametrize("model", ["OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "FOV", "EUCM"])
def test_other_lenses(model):
    start = make_problem(model=model, num_images=8, num_points=400, track=5, format="colmap")
    solved = bundle.solve(start).problem
    assert not kinds(solved) & {"outliers", "lens_model", "motion", "image_residuals"}


def test_rigs():
    solved = bundle.solve(rig_problem(num_frames=8, num_points=200)).problem
    assert not kinds(solved) & {"not_refined", "outliers", "lens_model", "motion", "weak_joint"}


def test_bal_without_names_and_sizes(tmp_path):
    made = bundle.synthesize(num_images=10, num_points=500, outlier_share=0.05, seed=4)
    path = tmp_path / "problem.txt"
    bundle.save(bundle.solve(made.problem).problem, path)
    assert "outliers" in kinds(bundle.load(path))


def test_a_starting_point_is_not_judged_as_a_result():
    made = bundle.synthesize(scene="orbit", num_images=12, num_points=600, seed=1)
    assert kinds(made.problem) == {"not_refined"}
    assert kinds(made.ground_truth) == set()
    assert "not_refined" not in kinds(made.problem, is_minimum=True)


def test_held_parts_are_not_called_unrefined(sound):
    moved = sound.replace(points=sound.points * (1 + 1e-2))
    assert "not_refined" in kinds(moved)
    held = bundle.SolveOptions(refine=("poses",))
    solved = bundle.solve(moved, held).problem
    assert "not_refined" not in kinds(solved, options=held)


def test_real_models_have_the_findings_of_an_expert(bundle_data):
    expected = {
        "bartoszek": {"shared_lens", "duplicate_points"},
        "batmo_rigs": {"duplicate_points"},
        "crane_mast": {"lens_model", "duplicate_points"},
        "lund_door": {"outliers", "duplicate_points"},
        "maupertuis": {"outliers", "lens_model", "duplicate_points"},
        "video48": {"undetermined_intrinsics"},
        "vr_opencv": {"motion", "image_residuals", "duplicate_points"},
    }
    for name, wanted in expected.items():
        problem = bundle.load(bundle_data / "colmap" / name)
        found = find(problem)
        assert {finding.kind for finding in found} == wanted, name
        weak = [one.evidence["weak"] for one in found if one.kind == "image_residuals"]
        assert weak == ([[16]] if name == "vr_opencv" else [])


def test_rows_of_a_rolling_shutter_are_named(bundle_data):
    (found,) = find(bundle.load(bundle_data / "rolling_shutter/phone/model"))
    assert found.kind == "motion" and "rows" in found.sentence
    assert found.command.endswith("--rolling-shutter rows")
    assert found.evidence["explained"] > 0.9
    assert found.evidence["rows"] > 1.5 * found.evidence["columns"]
