"""Scale bars against a dense reference of another program, differences, and truth; their file."""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.point_check import BarCheck
from bundle.georeference.scale_bars import FoundBars, ScaleBarErrors, _Residual, read_scale_bars
from bundle.graphs.factors.factors import FunctionFactor
from tests.cli.conftest import run  # noqa: F401 (a fixture)
from tests.georeference.flights import flight
from tests.scenes import make_problem

TARGETS = [[-20, -20, 0], [20, -20, 0.5], [0, 20, -0.5], [18, 18, 0.2], [-18, 17, 0.1]]
TIGHT = {
    "function_tolerance": 1e-15, "gradient_tolerance": 1e-14, "parameter_tolerance": 1e-13,
    "num_threads": 1, "max_num_iterations": 300,
}  # fmt: skip


@pytest.fixture(scope="module")
def orbit():
    """Sixteen images, and four bars of 2 mm between points of at least four rays."""
    scene = bundle.synthesize(
        scene="orbit", num_images=16, num_points=80, seed=8, cameras="shared"
    )  # fmt: skip
    truth = scene.ground_truth
    counts = np.bincount(truth.observation_point, minlength=80)
    rows = np.flatnonzero(counts >= 4)[:8].reshape(4, 2)
    lengths = np.linalg.norm(truth.points[rows[:, 0]] - truth.points[rows[:, 1]], axis=1)
    lengths += 0.002 * np.random.default_rng(8).normal(size=4)
    ids = scene.problem.point_ids[rows].tolist()
    bars = [
        bundle.ScaleBar(("point", a), ("point", b), length, 0.002)
        for (a, b), length in zip(ids, lengths.tolist(), strict=True)
    ]
    sigmas = np.full(scene.problem.num_observations, 0.5)
    return scene.problem.replace(observation_sigma=sigmas), bars


COSTS = (195.1681917116, 195.2235821858, 195.3456826725, 195.3481858852)
LENGTHS = (1.52963551, 1.12272061, 1.41312922, 1.50991076)
SIGMAS = (0.0013599, 0.0012772, 0.0013177, 0.0013899)


def wrong(bar, by):
    return bundle.ScaleBar(bar.a, bar.b, bar.distance + by, bar.sigma, bar.role)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_costs_lengths_and_sigmas_are_those_of_the_reference(orbit, count):
    problem, bars = orbit
    result = bundle.solve(problem, priors=bars[:count], **TIGHT)
    assert result.summary.final_cost == pytest.approx(COSTS[count - 1], rel=1e-10)
    checks = result.survey_checks.bars
    assert not any(bar.is_suspect for bar in checks)
    if count == 1:  # it sets the scale
        assert checks[0].redundancy < 1e-5 and np.isnan(checks[0].w)
        assert checks[0].length == pytest.approx(bars[0].distance, abs=1e-9)
    if count == 2:
        assert checks[0].w == pytest.approx(-checks[1].w, rel=1e-4)
    if count == 4:
        np.testing.assert_allclose([bar.length for bar in checks], LENGTHS, atol=6e-9)
        sigmas = [bar.bar.sigma * np.sqrt(1 - bar.redundancy) for bar in checks]
        np.testing.assert_allclose(sigmas, SIGMAS, atol=6e-8)


def test_the_wrong_bar_is_named(orbit):
    """The third is wrong by 20 sigmas."""
    problem, bars = orbit
    bars = [*bars[:2], wrong(bars[2], 0.04), bars[3]]
    checks = bundle.solve(problem, priors=bars, **TIGHT).survey_checks.bars
    np.testing.assert_allclose([bar.w for bar in checks], [5.9, 3.3, -14.5, 5.6], atol=0.06)
    assert [bar.is_suspect for bar in checks] == [False, False, True, False]
    robust = [bundle.ScaleBar(b.a, b.b, b.distance, b.sigma, loss="cauchy") for b in bars]
    checks = bundle.solve(problem, priors=robust, **TIGHT).survey_checks.bars
    assert checks[2].is_suspect and abs(checks[0].residual) < 3 * 0.002


def test_a_check_bar_changes_nothing_and_is_compared(orbit):
    problem, bars = orbit
    check = bundle.ScaleBar(bars[3].a, bars[3].b, bars[3].distance + 0.04, 0.002, "check")
    plain = bundle.solve(problem, priors=bars[:3], **TIGHT)
    result = bundle.solve(problem, priors=[*bars[:3], check], **TIGHT)
    assert result.summary.final_cost == plain.summary.final_cost
    found = result.survey_checks.bars
    assert [bar.is_suspect for bar in found] == [False, False, False, True]
    # The length without the bar: that of the reference with it, and its residual over R.
    w = found[3].residual / np.hypot(0.002, 0.0013899 / np.sqrt(1 - (0.0013899 / 0.002) ** 2))
    assert found[3].w == pytest.approx(w, rel=1e-3)


def test_jacobians_agree_with_differences():
    graph = bundle.FactorGraph()
    pose = [0.1, -0.2, 0.3, 0.9, 1.0, -2.0, 3.0]
    graph.add_variable("a", pose, "se3")
    graph.add_variable("b", [0.4, 0.1, 0.2, 0.8, 2.0, 1.0, 1.0], "se3")
    graph.add_variable("p", [1.0, 5.0, -2.0])
    for keys in (["a", "b"], ["a", "p"], ["p", "b"]):
        graph.add_factor(FunctionFactor(keys, _Residual(bundle.ScaleBar("a", "b", 1.5, 0.01))))
    assert graph.check_gradients().ok


def test_a_length_changes_with_the_translations_of_its_images():
    problem = make_problem(num_images=3, num_points=20)
    keys = ((("image", int(problem.image_ids[0])), ("image", int(problem.image_ids[2]))),)
    bars = FoundBars((bundle.ScaleBar(*keys[0], 1.0),), keys)
    images, points = bars.gradient(problem, 0)
    assert not points.any() and not images[1].any()
    for row in (0, 2):
        for column in range(3):
            ends = []
            for step in (-1e-6, 1e-6):
                poses = problem.cam_from_world.copy()
                poses[row, 4 + column] += step
                ends.append(bars.lengths(problem.replace(cam_from_world=poses))[0])
            assert images[row, 3 + column] == pytest.approx((ends[1] - ends[0]) / 2e-6, abs=1e-8)


def bars_between(problem, errors, sigmas):
    """Bars between points of a problem that are shorter than there by the errors."""
    pairs = problem.point_ids[: 2 * len(errors)].reshape(-1, 2).tolist()
    keys = tuple((("point", a), ("point", b)) for a, b in pairs)
    ends = problem.points[: 2 * len(errors)].reshape(-1, 2, 3)
    lengths = np.linalg.norm(np.diff(ends, axis=1)[:, 0], axis=1)
    given = [
        bundle.ScaleBar(*key, length - error, sigma)
        for key, length, error, sigma in zip(keys, lengths.tolist(), errors, sigmas, strict=True)
    ]
    return FoundBars(tuple(given), keys), lengths


@pytest.mark.parametrize(("w", "is_suspect"), [(3.0, False), (3.05, True)])
def test_the_level_of_one_per_cent_is_that_of_all_bars(w, is_suspect):
    """|w| of the largest of four exceeds 3.023 by chance in 1 % of the cases."""
    problem = make_problem(num_images=2, num_points=20)
    bars, _ = bars_between(problem, [0, w * 0.01, 0, 0], [0.01] * 4)
    found = bars.checks(problem, np.zeros((4, 4)), is_free=False)
    assert found[1].w == pytest.approx(w, rel=1e-9)
    assert [bar.is_suspect for bar in found] == [False, is_suspect, False, False]


@pytest.mark.parametrize(
    ("own", "expected"), [(0.12, [True, True]), (0.062, [True, True]), (0.059, [False, False])]
)
def test_two_bars_that_contradict_are_both_named_where_one_redundancy_is_small(own, expected):
    """Both have one test; one redundancy is below 0.01, the other on both sides of 0.02."""
    problem = make_problem(num_images=2, num_points=20)
    sigmas = np.array([own, own / 6])
    _, lengths = bars_between(problem, [0, 0], sigmas)
    slack = np.full(2, 0.2)  # standard deviations of the lengths by all else
    m = np.linalg.inv(np.diag(slack**2 + sigmas**2))
    m -= np.outer(m @ lengths, m @ lengths) / (lengths @ m @ lengths)
    v = -np.diag(sigmas**2) @ m @ [3.0, 0.0]  # the residuals of an error of 3 m
    bars, _ = bars_between(problem, v, sigmas)
    found = bars.checks(problem, np.diag(slack**2), is_free=True)
    assert found[0].redundancy == pytest.approx(own**2 * m[0, 0], rel=1e-9)
    assert (found[0].redundancy > 0.02) == expected[0]
    assert found[1].redundancy < 0.01 and np.isnan(found[1].w)
    assert [bar.is_suspect for bar in found] == expected


@pytest.mark.parametrize("is_free", [True, False])
def test_tests_of_bars_are_those_of_a_fit_with_all_lengths(is_free):
    """The oracle takes a free scale as a variance of 30 along the lengths."""
    rng = np.random.default_rng(5)
    problem = make_problem(num_images=2, num_points=20)
    keys = tuple((("point", a), ("point", b)) for a, b in problem.point_ids[:10].reshape(5, 2))
    lengths = np.linalg.norm(np.diff(problem.points[:10].reshape(5, 2, 3), axis=1)[:, 0], axis=1)
    sigmas, residuals = np.array([0.001, 0.02, 0.03, 0.05, 0.02]), 0.03 * rng.normal(size=5)
    control = np.array([True, False, True, True, False])
    bars = tuple(
        bundle.ScaleBar(*key, float(d - v), s, role="control" if used else "check")
        for key, d, v, s, used in zip(keys, lengths, residuals, sigmas, control, strict=True)
    )
    root = 0.02 * rng.normal(size=(5, 5))
    covariance = root @ root.T
    total = covariance + (30 * np.outer(lengths, lengths) if is_free else 0)
    weight = np.linalg.inv((total + np.diag(sigmas**2))[np.ix_(control, control)])
    gain = total[np.ix_(~control, control)] @ weight
    left = total[np.ix_(~control, ~control)] - gain @ total[np.ix_(control, ~control)]
    variance, redundancy = np.zeros(5), np.ones(5)
    variance[~control] = np.diag(left) + sigmas[~control] ** 2
    redundancy[control] = sigmas[control] ** 2 * np.diag(weight)
    variance[control] = sigmas[control] ** 2 * redundancy[control]
    found = FoundBars(bars, keys).checks(problem, covariance, is_free=is_free)
    np.testing.assert_allclose([one.redundancy for one in found], redundancy, rtol=1e-4)
    expected = np.where(redundancy < 0.01, np.nan, residuals / np.sqrt(variance))
    assert np.isnan(expected).any() and np.isfinite(expected[control]).any()
    np.testing.assert_allclose([one.w for one in found], expected, rtol=1e-4)


def test_residuals_are_summed_up_in_millimetres():
    bar = bundle.ScaleBar("a.jpg", "b.jpg", 2.0, 0.005)
    checks = tuple(BarCheck(bar, 2.0 + v, np.nan, np.nan, False) for v in (0.003, -0.004))
    (said,) = ScaleBarErrors(checks).sentences
    assert "2 scale bars: RMS 3.536 mm" in said


def test_images_give_the_model_its_scale():
    truth = make_problem(num_images=5, num_points=40, seed=3, perturbation=1e-3, shared=True)
    centers = truth.projection_centers
    lengths = [np.linalg.norm(centers[0] - centers[k]) for k in (2, 4)]
    bars = [
        bundle.ScaleBar("image0.jpg", f"image{k}.jpg", 10 * length, 0.001)
        for k, length in zip((2, 4), lengths, strict=True)
    ]
    result = bundle.solve(truth, priors=bars)
    assert result.similarity.scale == pytest.approx(10, rel=1e-3)
    assert result.problem.num_points == truth.num_points
    found = result.survey_checks.bars
    assert all(abs(bar.residual) < 0.01 for bar in found)
    # Beside factors the model stays, and the bars pull.
    hold = bundle.PositionFactor(("image", 1), centers[0], np.eye(3))
    assert bundle.solve(truth, priors=bars, factors=[hold]).similarity is None


def bars_of(scene, offsets, sigma=0.005):
    """Bars between the targets of a flight, as surveyed but for their offsets."""
    places = [np.array(target.position) for target in scene.gcps]
    pairs = [(0, 1), (1, 2), (2, 3), (3, 4)][: len(offsets)]
    return [
        bundle.ScaleBar(f"t{a}", f"t{b}", float(np.linalg.norm(places[a] - places[b]) + by), sigma)
        for (a, b), by in zip(pairs, offsets, strict=True)
    ]


def test_bars_between_control_points():
    scene = flight(TARGETS, seed=1, survey_noise=0.0)
    bars = bars_of(scene, (0, 0, 0.3, 0))
    result = bundle.solve(scene.problem, priors=[*scene.gcps, *bars])
    assert result.problem.num_points == scene.problem.num_points
    assert [bar.is_suspect for bar in result.survey_checks.bars] == [False, False, True, False]
    assert set(result.survey_checks.points) == {f"t{k}" for k in range(5)}
    clean = bundle.solve(scene.problem, priors=[*scene.gcps, *bars_of(scene, (0, 0, 0))])
    assert not any(bar.is_suspect for bar in clean.survey_checks.bars)
    assert max(abs(bar.w) for bar in clean.survey_checks.bars) < 3.3


def test_rounds_held_out_local_and_resumed_solves_have_bars(tmp_path):
    problem = make_problem(num_images=5, num_points=40, seed=3, perturbation=1e-3, shared=True)
    bars = [
        bundle.ScaleBar("image0.jpg", "image4.jpg", 30.0, 0.001),
        bundle.ScaleBar(("point", 3), ("point", 7), 9.0, 5.0),
    ]
    given = {"priors": bars, "num_rounds": 2, "deterministic": True}
    whole = bundle.solve_rounds(problem, **given, checkpoint=tmp_path / "c")
    assert whole.survey_checks.bars[0].length == pytest.approx(30, abs=0.01)
    again = bundle.solve_rounds(problem, **given, resume=tmp_path / "c")
    np.testing.assert_array_equal(again.problem.points, whole.problem.points)
    with pytest.raises(bundle.InputError, match="factors and bounds"):
        other = {**given, "priors": [bars[0], wrong(bars[1], 1.0)]}
        bundle.solve_rounds(problem, **other, resume=tmp_path / "c")
    assert bundle.solve_rounds(problem, **given, hold_out=10).held_out.num_observations > 0
    local = bundle.solve_rounds(problem, **{**given, "num_rounds": 0}, only_images=[1, 2])
    assert local.similarity is None
    with pytest.raises(bundle.InputError, match=r"^factors: expected .* found "):
        bundle.solve(problem, priors=bars, backend="fused")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("a", "a", 1.0), "two places"),
        (("a", "b", 0.0), "distance"),
        (("a", "b", float("nan")), "distance"),
        (("a", "b", 1.0, -1.0), "sigma"),
        (("a", "b", 1.0, 1.0, "other"), "role"),
        ((3, "b", 1.0), "expected names"),
    ],
)
def test_a_bar_without_meaning_is_one_line(arguments, words):
    with pytest.raises(bundle.InputError, match=words) as error:
        bundle.ScaleBar(*arguments)
    assert "\n" not in str(error.value)


def test_unknown_ends_are_one_line():
    problem = make_problem(num_images=3, num_points=10)
    for bar, words in (
        (bundle.ScaleBar("image0.jpg", "t9", 1.0), "t9"),
        (bundle.ScaleBar(("point", 99), ("point", 1), 1.0), "99"),
    ):
        with pytest.raises(bundle.InputError, match=words):
            bundle.solve(problem, priors=[bar])
    twice = [bundle.ScaleBar(a, b, 1.0) for a, b in ((("point", 1), ("point", 2)),) * 2]
    with pytest.raises(bundle.InputError, match="each bar once"):
        FoundBars.make(problem, twice)
    points = problem.points.copy()
    points[1] = points[0]
    with pytest.raises(bundle.InputError, match="apart"):
        bundle.solve(problem.replace(points=points), priors=twice[:1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "found 0"),
        ("image0.jpg image1.jpg", "line 1: expected A B distance"),
        ("image0.jpg image1.jpg 1 2 3", "found 5 words"),
        ("image0.jpg image1.jpg 0", "distance: expected metres above 0"),
        ("image0.jpg image1.jpg 1 0", "sigma: expected metres above 0"),
        ("image0.jpg image1.jpg x", "distance"),
        ("image0.jpg t1 2", "line 1: expected the name of an image"),
        ("image0.jpg image0.jpg 2", "two places"),
        ("image0.jpg image1.jpg 2\n# x\nimage1.jpg image0.jpg 3", "first in line 1"),
    ],
)
def test_a_bad_line_is_named(tmp_path, text, words):
    file = tmp_path / "bars.txt"
    file.write_text(text)
    with pytest.raises(bundle.InputError, match=words) as error:
        read_scale_bars(make_problem(num_images=3), scale_bars=file)
    assert "bars.txt" in str(error.value) and "\n" not in str(error.value)


def test_a_file_has_sigmas_roles_and_comments(tmp_path):
    file = tmp_path / "bars.txt"
    file.write_text("# bars\nimage0.jpg image1.jpg 2.5 0.01\n\nimage1.jpg,image2.jpg,3,check\n")
    first, second = read_scale_bars(
        make_problem(num_images=3), scale_bars=file, scale_bar_sigma=0.2, prior_loss="huber"
    ).priors
    assert (first.distance, first.sigma, first.role, first.loss) == (2.5, 0.01, "control", "huber")
    assert (second.a, second.distance, second.sigma, second.role) == ("image1.jpg", 3, 0.2, "check")


def test_refine_reports_bars(run, tmp_path):  # noqa: F811
    scene = bundle.synthesize(num_images=8, num_points=120, seed=5)
    names = tuple(f"image{image}.jpg" for image in scene.problem.image_ids.tolist())
    bundle.save(scene.problem.replace(image_names=names), tmp_path / "model", "colmap")
    centers = scene.ground_truth.projection_centers
    pairs = [(0, 3), (1, 5), (2, 7), (4, 6)]
    lengths = [float(np.linalg.norm(centers[a] - centers[b])) for a, b in pairs]
    lengths[1] *= 1.2
    lines = [f"{names[a]} {names[b]} {d}" for (a, b), d in zip(pairs, lengths, strict=True)]
    (tmp_path / "bars.txt").write_text("\n".join(lines))
    words = ("--scale-bars", tmp_path / "bars.txt", "--scale-bar-sigma", "0.02")
    done = run(
        "refine", tmp_path / "model", "-o", tmp_path / "out", *words, "--json",
        tmp_path / "r.json", "--html", tmp_path / "p.html", "--verbose",
    )  # fmt: skip
    assert done.code == 0, done.err
    report = json.loads((tmp_path / "r.json").read_text())
    assert [bar["is_suspect"] for bar in report["scale_bars"]["bars"]] == [
        False,
        True,
        False,
        False,
    ]
    assert "4 scale bars: RMS" in done.out and "probably wrong" in done.out
    assert "Scale bars" in (tmp_path / "p.html").read_text()
    # Follow the advice.
    lines[1] += " check"
    (tmp_path / "bars.txt").write_text("\n".join(lines))
    again = run("refine", tmp_path / "model", "-o", tmp_path / "out2", *words, "--json", "-")
    bars = json.loads(again.out)["scale_bars"]["bars"]
    assert [abs(bar["w"]) > 3.3 for bar in bars] == [False, True, False, False]
    assert run("covariance", tmp_path / "out2", "-o", tmp_path / "c.npz", *words).code == 0
    seen = run("diagnose", tmp_path / "out2", "--reliability", *words, "--json", "-")
    priors = json.loads(seen.out)["reliability"]["priors"]
    assert [one["num_residuals"] for one in priors] == [1, 1, 1]  # without the check bar
    assert sum(one["redundancy"] for one in priors) < 2  # one of them sets the scale


def test_a_refusal_names_the_bar(orbit):
    problem, bars = orbit
    with pytest.raises(bundle.InputError, match=f"found factor 0, {bars[0].name}"):
        bundle.solve(problem, priors=bars[:1], backend="fused")
