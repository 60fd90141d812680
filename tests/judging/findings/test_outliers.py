"""Outliers: planted ones are found and named, sound scenes are not accused."""

import shlex
from types import SimpleNamespace

import numpy as np
import pytest

import bundle
from bundle.cli.main import command_parser
from bundle.interface.finding import Finding
from bundle.judging.findings import find as find_module
from bundle.judging.findings import measured as measured_module
from bundle.judging.findings.find import find
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.minimum import under_its_loss
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.outliers import outliers
from tests.campaigns.findings import judge, make
from tests.scenes import make_problem


def kinds(problem, **more):
    return {finding.kind for finding in find(problem, **more)}


@pytest.fixture(scope="module")
def scene():
    return bundle.synthesize(num_images=12, num_points=800, pixel_noise=0.4, seed=3)


@pytest.fixture(scope="module")
def spoiled():
    scene = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    )
    return bundle.solve(scene.problem).problem


def test_planted_outliers_are_found_and_the_command_parses(spoiled):
    found = {finding.kind: finding for finding in find(spoiled, source="a b/model")}["outliers"]
    assert found.evidence["num_outliers"] > 0.01 * spoiled.num_observations
    assert found.evidence["rmse_without"] < found.evidence["rmse"]
    words = shlex.split(found.command)
    assert words[:3] == ["bundle", "refine", "a b/model"]
    parsed = command_parser().parse_args(words[1:])
    assert parsed.loss == "cauchy" and parsed.num_rounds is None  # nothing is deleted first


def test_gaussian_noise_is_no_outlier(scene):
    assert "outliers" not in kinds(bundle.solve(scene.problem).problem)


def test_nothing_is_deleted_after_a_loss_that_reduces_the_weight():
    start = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    ).problem
    result = bundle.solve(start, loss="cauchy")
    assert "outliers" not in kinds(result.problem, options=result.options)
    wide = bundle.solve(start, loss="cauchy", loss_scale=300.0)
    found = {one.kind: one for one in find(wide.problem, options=wide.options)}["outliers"]
    scale = float(shlex.split(found.command)[-1])
    assert scale == pytest.approx(2.4 * found.evidence["scale"], rel=0.05)


@pytest.mark.parametrize("loss", ["cauchy", "soft_l1", "trivial"])
def test_a_model_of_an_unknown_robust_solve_is_judged_under_its_loss(loss):
    start = bundle.synthesize(
        num_images=12, num_points=800, pixel_noise=0.4, outlier_share=0.05, seed=3
    ).problem
    model = bundle.solve(start, loss=loss).problem
    assert ("outliers" in kinds(model)) == (loss != "cauchy")
    whole = Measured(whole=model, command=NextCommand())
    used = under_its_loss(whole)
    assert used.options.loss == ("cauchy" if loss == "cauchy" else "trivial")
    assert used.command.given == (("--loss", "cauchy") if loss == "cauchy" else ())


@pytest.mark.parametrize(
    ("num_alone", "num_held", "are_named"),
    [(0, 10, False), (4, 10, False), (5, 10, True), (9, 10, True), (4, 8, True), (4, None, False)],
)
def test_outliers_are_those_that_the_images_alone_have(monkeypatch, num_alone, num_held, are_named):
    scene = make(40_000, ("positions",))
    known = {"priors": scene.priors, "align": True}
    result = bundle.solve(scene.start, num_threads=1, max_num_iterations=200, **known)
    stages, models, repaired = [], [], find_module.repaired

    def solved(measured, *repairs, **how):
        if how.get("with_priors") and num_held is None:
            return None
        return repaired(measured, *repairs, **how)

    def planted(stage, robust=None):
        stages.append(stage)
        models.append(robust)
        is_free = stage.whole is not result.problem and not stage.priors
        is_held = stage.whole is not result.problem and bool(stage.priors)
        many = num_alone if is_free else num_held if is_held else 10
        return judged([50.0] * many + [1.0] * 100, loss="trivial")

    monkeypatch.setattr(find_module, "repaired", solved)
    monkeypatch.setattr(find_module, "outliers", planted)
    found = find(result.problem, options=result.options, priors=scene.priors)
    assert ("outliers" in {one.kind for one in found}) == are_named
    given, again, alone, held = stages
    assert given.whole is again.whole is result.problem and given.priors
    assert models[1].whole is alone.whole  # its noise is that of the images alone
    assert alone.options is given.options and not alone.priors
    assert held.options is given.options and held.priors
    assert (held.whole is result.problem) == (num_held is None)  # that solve failed


def test_outliers_beside_positions_are_named_although_least_squares_doubles_them():
    scene = make(59_014)
    assert scene.planted == {"focal_drift", "outliers"}
    known = {"priors": scene.priors, "align": True}
    result = bundle.solve(scene.start, num_threads=1, max_num_iterations=200, **known)
    kinds = [one.kind for one in find(result.problem, options=result.options, priors=scene.priors)]
    assert "outliers" in kinds and "positions" not in kinds


def test_outliers_beside_wrong_sigmas_get_one_command_for_both():
    scene = make(59_106)
    assert scene.planted == {"outliers", "positions"}
    known = {"priors": scene.priors, "align": True}
    result = bundle.solve(scene.start, num_threads=1, max_num_iterations=200, **known)
    given = ("--loss-scale", "3", "--gps-sigma-scale", "2")
    judged = find(result.problem, options=result.options, priors=scene.priors, given=given)
    found = {one.kind: one for one in judged}
    words = [shlex.split(found[kind].command)[5:] for kind in ("outliers", "positions")]
    for flags in words:
        assert dict(zip(flags[::2], flags[1::2], strict=True)).keys() == {
            "--loss", "--loss-scale", "--gps-sigma-scale",
        }  # fmt: skip
    assert sorted(words[0]) == sorted(words[1])


def test_later_commands_have_the_scale_that_the_outliers_need():
    scene = make(7_005, ("outliers", "shared_lens"))
    result = bundle.solve(scene.start, num_threads=1, max_num_iterations=200)
    found = {one.kind: one for one in find(result.problem, options=result.options)}
    words = shlex.split(found["shared_lens"].command)[5:]
    assert words[:3] == ["--loss", "cauchy", "--loss-scale"]
    assert 1.5 <= float(words[3]) / scene.noise <= 3.0
    assert words[4:] == ["--share-cameras", "all"]
    assert found["outliers"].command == found["shared_lens"].command


def judged(
    errors,
    *,
    loss="cauchy",
    loss_scale=1.0,
    scale=1.0,
    sigma=None,
    robust=None,
    sizes=(0, 0),
    refine=("poses", "points"),
):
    """Return the finding about these errors, in surroundings of this scale.

    robust is the scale after a robust solve; sizes are the numbers of points and images.
    """
    errors = np.asarray(errors, float)
    measured = SimpleNamespace(
        counted=np.ones(len(errors), bool),
        errors=errors,
        local_scale=np.full(len(errors), scale),
        scale=scale,
        options=SimpleNamespace(loss=loss, loss_scale=loss_scale, refine=refine),
        problem=SimpleNamespace(observation_sigma=sigma, num_points=sizes[0], num_images=sizes[1]),
        command=NextCommand(),
    )
    measured.standardized = measured
    return outliers(measured, None if robust is None else SimpleNamespace(scale=robust))


@pytest.mark.parametrize(
    ("far", "others", "is_found"),
    [
        ([6.001] * 3, [1.0] * 400, True),  # 108.04 of 508: 21.3 %
        ([6.0] * 3, [1.0] * 400, False),  # not beyond 6 scales
        ([20.0] * 2, [1.0] * 400, False),  # two
        ([7.0] * 3, [1.0] * 588, True),  # 147 of 735: 20.0 %
        ([7.0] * 3, [1.0] * 589, False),
        ([7.0] * 3, [1.0] * 27, True),  # 30 observations
        ([7.0] * 3, [1.0] * 26, False),
    ],
)
def test_limits_of_the_test(far, others, is_found):
    found = judged([*far, *others], loss="trivial")
    assert (found is not None) == is_found
    if found is not None:
        share = np.sum(np.square(far)) / np.sum(np.square([*far, *others]))
        assert found.evidence["cost_share"] == pytest.approx(share)
        assert found.evidence["num_outliers"] == 3


def test_outliers_that_the_model_absorbs_are_found_by_standardized_errors():
    tight = {"function_tolerance": 1e-10, "num_threads": 1}
    made = bundle.synthesize(scene="orbit", num_images=8, num_points=120, pixel_noise=0.5, seed=1)
    clean = bundle.solve(made.problem, **tight).problem
    before = bundle.reliability(clean)
    order = np.argsort(np.abs(before.least_redundancy - 0.2))
    first = np.unique(clean.observation_point[order], return_index=True)[1]
    rows = order[np.sort(first)[:3]]  # of different points
    xy = clean.observation_xy.copy()
    xy[rows] += 14 * before.weakest_direction[rows]
    problem = bundle.solve(clean.replace(observation_xy=xy), **tight).problem
    measured = Measured(whole=problem, command=NextCommand())
    tested = measured.standardized
    assert (tested.errors[rows] > 6 * tested.local_scale[rows]).all()
    assert not (measured.errors > 6 * measured.local_scale)[rows].any()
    known = bundle.reliability(problem).least_redundancy >= 0.02
    assert tested.counted[known].all()
    found = outliers(measured)
    assert found.evidence["num_outliers"] >= 3
    counted = measured.errors[tested.counted]
    assert found.evidence["rmse"] == pytest.approx(np.sqrt((counted**2).mean()))
    assert outliers(Measured(whole=clean, command=NextCommand())) is None


def test_errors_without_a_redundancy_stay_as_they_are(monkeypatch, scene):
    count = Measured(whole=scene.problem, command=NextCommand()).work
    assert count == scene.problem.num_observations + 20 * scene.problem.num_images**2
    for name, sigmas in (("CHEAP_ERRORS", None), ("CHEAP_COVARIANCE", (np.zeros((0, 0)), 1.0))):
        for limit, is_large in ((count, False), (count - 1, True)):
            monkeypatch.setattr(measured_module, name, limit)
            measured = Measured(whole=scene.problem, command=NextCommand(), lens_sigmas=sigmas)
            assert (measured.standardized is measured) == is_large
        monkeypatch.undo()
    apart = (scene.problem.observation_image < 6) == (scene.problem.observation_point < 400)
    pieces = scene.problem.select(observations=apart).problem
    measured = Measured(whole=pieces, command=NextCommand())
    np.testing.assert_array_equal(measured.standardized.errors, measured.errors)


@pytest.mark.parametrize("loss", ["trivial", "huber", "soft_l1"])
def test_losses_whose_influence_stays_are_replaced(loss):
    assert "--loss cauchy" in judged([50.0] * 10 + [1.0] * 100, loss=loss).command


@pytest.mark.parametrize("loss", ["trivial", "huber"])
@pytest.mark.parametrize(
    ("robust", "loss_scale", "sigma", "advised"),
    [
        (None, 0.1, 1.0, None),  # without a robust solve the noise is not known
        (0.66, 1.0, 1.0, None),  # 1.5 times the noise is 0.99 px
        (0.67, 1.0, 1.0, "1.6"),
        (0.67, 1.1, 1.0, None),  # the scale of the run
        (1.34, 1.0, 2.0, "1.6"),  # in sigmas
        (1.32, 1.0, 2.0, None),
        (9.0, 1.0, 1.0, "4.8"),  # at most the scale before it, 2
    ],
)
def test_a_loss_below_the_noise_gets_a_larger_scale(loss, robust, loss_scale, sigma, advised):
    known = {"loss": loss, "loss_scale": loss_scale, "robust": robust, "scale": 2.0}
    found = judged([50.0] * 10 + [1.0] * 100, sigma=np.full(110, sigma), **known)
    flags = shlex.split(found.command)[5:]
    assert flags == ["--loss", "cauchy", *(["--loss-scale", advised] if advised else [])]


@pytest.mark.parametrize("loss", ["cauchy", "tukey", "arctan"])
def test_a_loss_far_above_the_noise_gets_a_smaller_scale(loss):
    found = judged([50.0] * 10 + [1.0] * 100, loss=loss, loss_scale=100.0)
    assert shlex.split(found.command)[5:] == ["--loss", "cauchy", "--loss-scale", "2.4"]
    assert judged([50.0] * 10 + [1.0] * 100, loss=loss, loss_scale=1.0) is None


@pytest.mark.parametrize(
    ("sizes", "refine", "is_found"),
    # 110 observations tell at most (110 - unknowns / 2) / 2 outliers apart, of which there are 10.
    [
        ((60, 0), ("points",), True),
        ((61, 0), ("points",), False),
        ((58, 1), ("poses", "points"), True),
        ((58, 2), ("poses", "points"), False),
        ((58, 2), ("points", "focal"), True),
        ((999, 30), ("poses",), True),
        ((999, 31), ("poses",), False),
        ((999, 31), ("focal",), True),
    ],
)
def test_more_outliers_than_the_redundancy_tells_apart_are_not_named(sizes, refine, is_found):
    errors, known = [50.0] * 10 + [1.0] * 100, {"sizes": sizes, "refine": refine}
    assert (judged(errors, loss="tukey", loss_scale=100.0, **known) is not None) == is_found
    assert judged(errors, loss="huber", **known) is not None


def test_good_observations_that_a_loss_rejects_in_points_of_two_images_are_no_outliers():
    """Tukey's loss fits 80 of 120 observations within 0.01 px, at a noise of 0.7 px."""
    problem = make_problem(
        num_images=6, num_points=60, track=2, seed=9, perturbation=1e-3, noise=0.7, shared=True
    )
    solved = bundle.solve(problem, loss="tukey")
    measured = Measured(whole=solved.problem, command=NextCommand(), options=solved.options)
    assert measured.scale < 0.05
    assert outliers(measured) is None


def test_influence_decides_after_a_bounded_loss():
    # psi^2 = e^2 / (1 + e^2 / c^2)^2 with c = 10: 9 at 30, and 0.980296 at 1.
    known = {"loss_scale": 10.0}
    assert judged([30.0] * 3 + [1.0] * 110, **known)  # 27 of 134.83: 20.02 %
    assert judged([30.0] * 3 + [1.0] * 111, **known) is None  # 19.88 %
    found = judged([30.0] * 3 + [1.0] * 111, sigma=np.full(114, 30.0), **known)
    assert "they have 95.98 % of the influence" in found.sentence  # 2.9409 of 3.0642
    many = [7.0] * 40 + [1.0] * 60
    assert judged(many, loss_scale=2.41)
    assert judged(many, loss_scale=2.4) is None  # the scale is not raised
    halves = {"sigma": np.full(100, 0.5)}
    assert judged(many, loss_scale=4.81, **halves).command.endswith("--loss-scale 4.8")
    assert judged(many, loss_scale=4.8, **halves) is None


def test_a_model_of_five_observations_has_no_findings_and_no_error(scene):
    few = scene.problem.select(observations=np.arange(5)).problem
    assert "outliers" not in kinds(few)


def test_the_next_command_keeps_the_flags_of_this_run(spoiled):
    given = ["--loss", "huber", "--share-cameras", "all", "--fix-images", "1", "2"]
    found = find(spoiled, given=given, options=bundle.SolveOptions())
    words = shlex.split(found[0].command)
    assert words.count("--loss") == 1 and "huber" not in words
    assert words[words.index("--share-cameras") :][:2] == ["--share-cameras", "all"]


@pytest.mark.parametrize(
    ("seed", "kind", "flag"),
    [
        (64_113, "lens_model", "--camera-model"),  # the loss alone makes positions 21 % worse
        (66_006, "motion", "--rolling-shutter"),  # 11 %
    ],
)
def test_a_loss_beside_another_cause_of_large_errors_has_its_repair(seed, kind, flag):
    far, other = judge(make(seed))
    assert (far.kind, other.kind) == ("outliers", kind)
    words = shlex.split(far.command)
    assert far.command == other.command and {"--loss", flag} <= set(words)


@pytest.mark.parametrize(
    ("others", "expected"),
    [
        ((), "loss"),
        ((("lens_model", ""), ("motion", "")), "loss"),  # nothing to add
        ((("shared_lens", "bundle validate INPUT"),), "loss"),
        ((("undetermined_intrinsics", "bundle refine prior"),), "loss"),
        ((("motion", "bundle refine rows"), ("lens_model", "")), "bundle refine rows"),
        # Motion hides the field of a lens, and lenses are compared after both.
        ((("motion", "bundle refine rows"), ("lens_model", "bundle refine both")),
         "bundle refine both"),
        ((("lens_model", "bundle refine lens"), ("shared_lens", "bundle refine all")),
         "bundle refine all"),
    ],
)  # fmt: skip
def test_a_loss_has_the_repairs_of_the_last_stage(monkeypatch, spoiled, others, expected):
    told = [("outliers", "loss"), *others]
    found = [Finding(kind=kind, sentence="", command=command) for kind, command in told]
    monkeypatch.setattr(find_module, "_findings", lambda _: iter(found))
    commands = {one.kind: one.command for one in find(spoiled)}
    assert commands == dict(told) | {"outliers": expected}
