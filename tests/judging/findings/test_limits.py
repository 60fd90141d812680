"""Exact numbers on both sides of the limits of lens fields, motion, weak images and score tests."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bundle.judging.findings import images, larger_lens, lens_terms, minimum, systematic
from bundle.judging.findings.images import between_images, image_residuals, motion
from bundle.judging.findings.lens_terms import LENS_TERMS, fields_of_lenses, lens_model
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.systematic import SystematicResiduals
from tests.judging.findings.test_lens_terms import MEASURED, field
from tests.scenes import make_problem


def images_of(count):
    return [SimpleNamespace(image=k, rows=slice(0, 0)) for k in range(count)]


@pytest.mark.parametrize(("size", "is_found"), [(0.129, False), (0.131, True)])
def test_a_field_of_a_lens_counts_from_its_size(size, is_found):
    assert (lens_model(MEASURED, [field(1.0, 0.0, size=size)]) is not None) == is_found


def test_the_percentile_is_that_of_the_lengths():
    one = field(1.0, 0.0)
    lengths = np.random.default_rng(0).permutation(np.arange(1.0, 101.0))
    columns = np.zeros((100, 2, 2))
    columns[:, 0, 0] = columns[:, 1, 1] = 1.0
    flat = np.stack([0.6 * lengths, 0.8 * lengths], axis=1)
    many = replace(one, columns=columns, residual=flat, field=flat)
    assert lens_model(MEASURED, [many]).evidence["percentile_99"] == pytest.approx(99.0)


def wald(strength, *, num_images, effect=0.0):
    """Return what _wald finds in one column, and the statistics by observations and by images."""
    rng = np.random.default_rng(3)
    image = np.repeat(np.arange(num_images), 40).astype(np.int32)
    column = rng.normal(size=(len(image), 2, 1))
    own = effect * np.where(image % 2, 1.0, -1.0)
    residual = (strength + own[:, None]) * column[:, :, 0] + rng.normal(size=column.shape[:2])
    flat = column.reshape(-1)
    theta = flat @ residual.reshape(-1) / (flat @ flat)
    scores = (column[:, :, 0] * (residual - theta * column[:, :, 0])).sum(axis=1)
    statistics = [
        theta**2 * (flat @ flat) ** 2 / (sums**2).sum()
        for sums in (scores, np.bincount(image, scores))
    ]
    return lens_terms._wald(column, residual, image), theta, statistics


def strength_of(limit, which, **given):
    """Return the strength at which a statistic is a limit, by bisection."""
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        below = wald(middle, **given)[2][which] < limit
        low, high = (middle, high) if below else (low, middle)
    return low


@pytest.mark.parametrize(
    ("limit", "which", "given"),
    [
        (1 + 6 * np.sqrt(2) + 20, 0, {"num_images": 9}),
        (1 + 3.1 * np.sqrt(2) + 5.5, 1, {"num_images": 10, "effect": 1.0}),
    ],
)
def test_a_field_is_significant_from_its_limits(limit, which, given):
    strength = strength_of(limit, which, **given)
    for factor, expected in ((0.99, False), (1.01, True)):
        (coefficients, statistic, significant), theta, statistics = wald(factor * strength, **given)
        assert coefficients == pytest.approx([theta]) and significant == expected
        assert statistic == pytest.approx(statistics[0])
        assert which == 0 or statistics[0] > 40


def test_images_need_not_agree_if_they_are_few():
    for count, significant in ((9, True), (10, False)):
        (_, by_observations, found), _, statistics = wald(0.8, num_images=count, effect=1.0)
        assert by_observations > 50 and statistics[1] < 7 and found == significant


@pytest.mark.parametrize(("count", "is_known"), [(99, False), (100, True)])
def test_a_lens_has_a_field_from_a_hundred_observations(count, is_known):
    columns = np.random.default_rng(1).normal(size=(count, 2, 6))
    found = SimpleNamespace(
        problem=SimpleNamespace(
            observation_image=np.zeros(count, np.int32), camera_ids=np.array([5])
        ),
        lens_columns=columns,
        lens_fields=columns,
        residuals=columns[:, :, 0],
        camera=np.zeros(count, np.int64),
        observations=np.arange(count),
        lenses=[("SIMPLE_RADIAL", np.ones(count, bool))],
    )
    assert bool(fields_of_lenses(found, 1.0)) == is_known


def test_fields_of_a_lens_are_their_formulas():
    found = SystematicResiduals.lens_columns.func(SimpleNamespace(xy=np.array([[1.0, 2.0]])))
    expected = [[5, 10], [25, 50], [125, 250], [7, 4], [4, 13], [1, -2]]
    assert LENS_TERMS == ("r2", "r4", "r6", "t1", "t2", "a")
    np.testing.assert_array_equal(found[0].T, expected)


@pytest.mark.parametrize(("left", "is_removed"), [(0.049, False), (0.051, True)])
def test_a_field_is_removed_if_a_twentieth_is_left(left, is_removed):
    columns = np.linalg.qr(np.random.default_rng(2).normal(size=(40, 6)))[0].reshape(20, 2, 6)
    fields = columns * np.array([left, 0, 0, 0, 0, 0])
    found = SimpleNamespace(
        residuals=columns[:, :, 0] + columns[:, :, 1],
        lens_columns=columns,
        lens_fields=fields,
        lenses=[("RADIAL", np.ones(20, bool))],
    )
    rest = SystematicResiduals.residuals_without_lens.func(found)
    expected = columns[:, :, 1] + (0 if is_removed else columns[:, :, 0])
    np.testing.assert_allclose(rest, expected, atol=1e-12)


def test_observations_that_take_part():
    # Images of 29, 30 and 900 features; one is found twice in the second, to a tenth of a pixel.
    count = np.array([29, 31, 900])
    image = np.repeat(np.arange(3), count).astype(np.int32)
    xy = np.stack([np.arange(960) * 0.2, np.zeros(960)], axis=1)
    xy[59] = xy[58] + 0.04
    problem = SimpleNamespace(
        observation_image=image, observation_xy=xy, num_images=3,
        observation_point=np.arange(960),
    )  # fmt: skip
    counted, clean = np.ones(960, bool), np.ones(960, bool)
    measured = SimpleNamespace(problem=problem, is_clean=clean, counted=counted)
    chosen, images_found = systematic._chosen(measured)
    assert images_found.tolist() == [1, 2]
    assert np.bincount(image[chosen], minlength=3).tolist() == [0, 30, 300]  # a third of 900
    assert not chosen[59] and (np.flatnonzero(chosen[60:]) % 3 == 0).all()
    clean[40] = False
    assert systematic._chosen(measured)[1].tolist() == [2]
    clean[40], counted[41] = True, False
    assert systematic._chosen(measured)[1].tolist() == [2]


def moving(
    monkeypatch, ratio, tau, *, excess=1.0, lens=0.0, scale=2.0, read=(1.0, 1.0, 0.0), is_lens=False
):
    monkeypatch.setattr(images, "between_images", lambda *_: (ratio, tau * scale, excess))
    monkeypatch.setattr(images, "direction", lambda _: read)
    monkeypatch.setattr(images, "gain_of_shutter", lambda *_: 3.0)
    monkeypatch.setattr(images, "_is_lens", lambda *_: is_lens)
    fits = SimpleNamespace(
        coefficients=np.zeros((7, 3)), variances=np.ones((7, 3)), sizes=np.arange(7.0)
    )
    found = SimpleNamespace(images=images_of(7), problem=SimpleNamespace(image_ids=np.arange(7)))
    measured = SimpleNamespace(scale=scale, command=NextCommand())
    one = motion(measured, found, fits, [field(1.0, 0.0, size=lens)])
    assert one is None or one.evidence["image_ids"] == [6, 5, 4]
    return one


def test_the_direction_of_a_shutter_is_named_from_limits(monkeypatch):
    for read, shutter, is_clear in (
        ((1.0, 1.0, 0.51), "rows", False),
        ((1.0, 1.0, 0.49), "", False),
        ((1.49, 1.0, 0.9), "rows", False),
        ((1.51, 1.0, 0.9), "rows", True),
        ((1.0, 1.49, 0.9), "rows", False),
        ((1.0, 1.51, 0.9), "columns", True),
    ):
        found = moving(monkeypatch, 4.1, 0.46, read=read)
        assert found.evidence["shutter"] == shutter
        assert [found.evidence[name] for name in ("rows", "columns", "explained")] == [*read]
        assert ("not clear" not in found.sentence) == is_clear
        assert "by 0.92 px" in found.sentence
        assert found.command.endswith(f"--rolling-shutter {shutter}" if shutter else "")


def test_limits_of_motion(monkeypatch):
    assert moving(monkeypatch, 4.1, 0.46)
    assert not moving(monkeypatch, 4.1, 0.46, is_lens=True)
    assert not moving(monkeypatch, 3.9, 0.46)
    assert not moving(monkeypatch, 4.1, 0.44)
    assert not moving(monkeypatch, 4.1, 0.46, excess=-1e-9)
    assert moving(monkeypatch, 4.1, 0.81, lens=0.1)  # 8 times the field of the lens
    assert not moving(monkeypatch, 4.1, 0.79, lens=0.1)


def test_the_excess_between_images_has_its_limit():
    values, dof = np.array([0.0, 6.0, 0.0, 6.0, 0.0, 6.0]), 5
    ratio, tau, excess = between_images(values, np.ones(6))
    assert ratio == pytest.approx(54 / dof) and tau == pytest.approx(np.sqrt(49 / 5))
    assert excess == pytest.approx(54 - (dof + 6 * np.sqrt(2 * dof) + 20))


def weak(ratios, *, count=10_000, medians=None):
    """Return the images that are weak among images with these scales."""
    num = len(ratios)
    measured = SimpleNamespace(
        image_scale=np.array(ratios, float),
        problem=SimpleNamespace(observation_image=np.repeat(np.arange(num), count)),
    )
    medians = np.where(np.array(ratios) > 1.2, 2.0, 1.0) if medians is None else medians
    return images._weak(
        measured, SimpleNamespace(images=images_of(num)), SimpleNamespace(medians=medians)
    )[0].tolist()


def test_limits_of_weak_images():
    assert weak([1.0] * 8 + [1.76]) == [8] and weak([1.0] * 8 + [1.74]) == []
    # The median deviation of the logarithms is 0.2: 3 times 1.4826 of it is a factor of 2.434.
    spread = [np.exp(0.2), np.exp(-0.2)] * 4 + [1.0]
    assert weak([*spread, 2.7]) == [9] and weak([*spread, 2.3]) == []
    # Five standard errors of 25 observations are a factor of 2.054.
    assert weak([1.0] * 8 + [2.1], count=25) == [8] and weak([1.0] * 8 + [2.0], count=25) == []
    # Errors without the linear field are usual: below 1.5 times the median.
    for last, expected in ((1.51, [8]), (1.49, [])):
        assert weak([1.0] * 8 + [2.0], medians=np.array([1.0] * 8 + [last])) == expected


def systematic_images(
    chi2, sizes, *, ratio=10.0, count=50, scale=1.0, loss="trivial", is_general=False,
    is_jointed=False,
):  # fmt: skip
    num = len(chi2)
    problem = SimpleNamespace(
        num_images=num, image_ids=np.arange(num), image_names=("",) * num,
        observation_image=np.repeat(np.arange(num), [count] + [50] * (num - 1)),
    )  # fmt: skip
    measured = SimpleNamespace(
        problem=problem, scale=scale, image_scale=np.array([ratio] + [1.0] * (num - 1)),
        command=NextCommand(), options=SimpleNamespace(loss=loss),
    )  # fmt: skip
    fits = SimpleNamespace(chi2=np.array(chi2), sizes=np.array(sizes), medians=np.ones(num))
    found = SimpleNamespace(images=images_of(num))
    which = {"is_general": is_general, "is_jointed": is_jointed}
    return image_residuals(measured, found, fits, **which)


def test_limits_of_images_with_systematic_residuals():
    limit = 3 + 6 * np.sqrt(6) + 20 + 2 * np.log(9)
    found = systematic_images([limit + 0.1, *[0.0] * 8], [0.51] * 9, scale=0.8)
    assert found.evidence["systematic"] == [0]
    assert found.command.endswith("--loss huber --loss-scale 2")
    beside = systematic_images([limit + 0.1, *[0.0] * 8], [0.51] * 9, is_jointed=True)
    assert beside.evidence["systematic"] == [0] and not beside.command
    assert systematic_images([limit - 0.1, *[0.0] * 8], [0.51] * 9) is None
    assert systematic_images([limit + 0.1, *[0.0] * 8], [0.49] * 9) is None
    assert systematic_images([limit + 0.1, *[0.0] * 8], [0.51] * 9, is_general=True) is None
    assert systematic_images([99.0] * 3 + [0.0] * 6, [0.51] * 9) is not None  # a third
    assert systematic_images([99.0] * 4 + [0.0] * 5, [0.51] * 9) is None


@pytest.mark.parametrize(
    ("ratio", "count", "share"),
    [
        (4.01, 50, 4.01**2 / (4.01**2 + 8)),  # 66.8 % of the squares
        (3.99, 50, 3.99**2 / (3.99**2 + 8)),  # 66.6 %
        (2.84, 100, 2.84**2 / (2.84**2 + 4)),  # twice as many observations as the others
        (2.82, 100, 2.82**2 / (2.82**2 + 4)),
    ],
)
def test_a_loss_is_advised_for_images_with_most_of_the_squares(ratio, count, share):
    known = {"ratio": ratio, "count": count}
    found = systematic_images([99.0, *[0.0] * 8], [0.51] * 9, **known)
    assert found.evidence["share"] == pytest.approx(share)
    assert bool(found.command) == (share > 2 / 3)
    assert not systematic_images([99.0, *[0.0] * 8], [0.51] * 9, loss="huber", **known).command


def absorbed(monkeypatch, statistic, moved, *, present=0.0):
    """Return the finding of a lens whose first larger model has this chi2 and movement."""

    def step(decrease, parameters, by):
        return SimpleNamespace(
            decrease=decrease, variance=1.0, squared_distance=decrease, num_residuals=100,
            num_parameters=parameters, moves=by, moves_beyond=lambda other: by - other.moves,
            position_sigma=lambda: 1.0,
        )  # fmt: skip

    ones = np.array([[1.0, 0.0, 0.0]])
    larger = step(statistic + present, 11, (moved + 3.0) * ones)
    monkeypatch.setattr(larger_lens, "_extended", lambda *_: larger)
    monkeypatch.setattr(larger_lens, "Step", lambda *_: step(present, 10, 3.0 * ones))
    whole = SimpleNamespace(
        image_camera=np.array([0]), camera_ids=np.array([7]), camera_models=("SIMPLE_PINHOLE",)
    )
    measured = SimpleNamespace(whole=whole, options=None, command=NextCommand())
    return larger_lens._found(measured, ["SIMPLE_RADIAL"])


def test_limits_of_an_absorbed_term(monkeypatch):
    # chi2 of one degree exceeds 15.137 with a probability of 1e-4.
    assert absorbed(monkeypatch, 15.2, 1.01).evidence["chi2"] == pytest.approx(15.2)
    assert absorbed(monkeypatch, 15.1, 1.01) is None
    assert absorbed(monkeypatch, 15.2, 0.99) is None
    assert absorbed(monkeypatch, 15.2, 1.01, present=500.0) is not None
    assert absorbed(monkeypatch, 15.1, 1.01, present=500.0) is None


@pytest.mark.parametrize(("left", "is_found"), [(0.79, True), (0.81, False)])
def test_a_model_is_not_refined_below_four_fifths(monkeypatch, left, is_found):
    monkeypatch.setattr(
        minimum, "_left", lambda _: iter([(left, "points", 0.2), (1.0, "poses", 0)])
    )
    measured = SimpleNamespace(scale=1.0, is_minimum=False, command=NextCommand())
    assert (minimum.not_refined(measured) is not None) == is_found


def test_poses_with_priors_are_not_moved_alone():
    problem = make_problem(num_images=4, num_points=60)
    for priors, expected in (((), ["points", "poses"]), (("prior",), ["points"])):
        measured = Measured(whole=problem, command=NextCommand(), priors=priors)
        assert [what for _, what, _ in minimum._left(measured)] == expected


def test_the_decrease_is_compared_with_what_noise_alone_allows():
    """Four images see all of 60 points: 480 residuals, 180 numbers of points and 24 of poses."""
    problem = make_problem(num_images=4, num_points=60, shared=True)
    assert problem.num_observations == 240
    found = list(minimum._left(Measured(whole=problem, command=NextCommand())))
    for (left, what, decrease), share in zip(found, (180 / 480, 24 / 480), strict=True):
        assert left == pytest.approx((1 - decrease) / (1 - share)), what


def test_the_decrease_is_a_share_of_the_cost():
    """Two groups of one unknown each: it takes 3 and 4 away, and leaves a 2 across."""
    residual = np.array([[3.0, 0.0], [4.0, 2.0]])
    jacobian = np.array([[[1.0], [0.0]], [[1.0], [0.0]]])
    found = minimum._decrease(residual, jacobian, np.array([0, 1]), np.ones(2))
    assert found == pytest.approx(25 / 29)
    doubled = minimum._decrease(2 * residual, jacobian, np.array([0, 1]), np.ones(2))
    assert doubled == pytest.approx(found)
    assert minimum._decrease(0 * residual, jacobian, np.array([0, 1]), np.ones(2)) == 0
