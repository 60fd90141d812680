"""Meaning of rules in a problem, and refusals in one line with their place."""

import numpy as np
import pytest

import bundle
from bundle.solving.constraints.resolve import apply
from bundle.solving.constraints.rule_list import Constraints
from tests import scenes
from tests.solving.constraints.lenses import mixed


def resolve(problem, *rules, part=None, **options):
    return apply(rules, problem, bundle.SolveOptions(**options), part)


REFUSED = {
    "camera 7: f fixed": "no camera 7",
    "cameras 4-6: f fixed": "no camera 6",
    "camera 1: k1 fixed": r"camera 1 \(SIMPLE_RADIAL\).*'k1'.*f, cx, cy, k$",
    "camera 2: k fixed": r"camera 2 \(OPENCV\).*f, fx, fy, cx, cy, k1, k2, p1, p2$",
    "cameras *: k7 fixed": r"no camera.*'k7'.*f, cx, cy, k, fx, fy, k1, k2, p1, p2",
    'image "left/*": rotation fixed': r"no image named 'left/\*'",
    "image 9: rotation fixed": "no image 9",
    "point 999: position fixed": "no point 999",
    "camera 1: f in [10, 20]": r"f of camera 1.*within \[10, 20\], found 800",
    "cameras *: f in [1e5, inf]": r"f of camera 1.*within \[100000, inf\]",
    "camera 1: cx prior sigma 1": "cx of camera 1.*refine lacks principal_point",
    "camera 2: p1,k2 prior 5 %": "p1 of camera 2.*0; give a sigma",
    "camera 1: f prior -5 2 %": "above 0",
    "camera 2: f/k1 fixed": "fx and fy",
    "camera 2: fx/k2 fixed": "k2 of camera 2 = 0",
}


@pytest.mark.parametrize("text", REFUSED)
def test_a_rule_that_does_not_fit_the_problem(text):
    with pytest.raises(bundle.InputError, match=REFUSED[text]) as error:
        resolve(mixed(), "point 1: position fixed", text)
    assert str(error.value).startswith("constraints[1]: ")
    assert "\n" not in str(error.value)


CONTRADICTIONS = {
    ("cameras *: f prior 2 %", "camera 1: f prior 1 %"): "already has a prior, by constraints.0.",
    ("cameras *: k prior 0 sigma 1", "camera 1: k fixed"): "constant by constraints.1.",
    ("camera 1: f in [1, 9999]", "camera 1: f in [2, 9999]"): "already has bounds",
    ("image 1: rotation prior sigma 1", "image 1: rotation fixed"): "constant by constraints.1.",
    ("point 1: position prior sigma 1", "point 1: position fixed"): "constant by constraints.1.",
    ("image 1: position prior sigma 1",) * 2: "already has a prior",
    ("camera 1: f in [1000, 1000]", "camera 1: f prior sigma 2"): "within|by constraints.0.",
}


@pytest.mark.parametrize("rules", CONTRADICTIONS, ids=" + ".join)
def test_rules_that_contradict_each_other(rules):
    with pytest.raises(bundle.InputError, match=CONTRADICTIONS[rules]) as error:
        resolve(mixed(), *rules)
    assert str(error.value).startswith("constraints[")


@pytest.mark.parametrize(
    ("text", "options", "why"),
    [
        ("camera 1: f prior 2 %", {"refine": "poses,points"}, "refine lacks focal"),
        ("camera 1: f prior 2 %", {"fixed_camera_ids": (1,)}, "camera 1 is a fixed camera"),
        ("image 2: rotation prior sigma 1", {"refine": "points"}, "refine lacks poses"),
        ("image 2: position prior sigma 1", {"fixed_image_ids": (2,)}, "one of the fixed images"),
        ("point 2: position prior sigma 1", {"fixed_point_ids": (2,)}, "one of the fixed points"),
    ],
)
def test_a_prior_on_what_the_options_hold(text, options, why):
    with pytest.raises(bundle.InputError, match=why):
        resolve(mixed(), text, **options)


def test_what_is_held():
    problem = mixed(image_names=["left/a.jpg", "left/b.jpg", "right/ä.jpg", "12", "right/[c].jpg"])
    _, applied = resolve(
        problem,
        "cameras *: f fixed",
        "camera 2: fx,p1 fixed",
        "camera 2: fx fixed",
        'image "left/*",5: rotation fixed',
        'image "12","right/ä.jpg": rotation,position fixed',
        "points 3,5-6: position fixed",
    )
    assert applied.held_params == {1: {0}, 2: {0, 1, 6}, 3: {0}, 4: {0, 1}, 5: {0}}
    assert applied.held_poses == {1: 1, 2: 1, 3: 3, 4: 3, 5: 1}
    assert applied.fixed_point_ids == (3, 5, 6)
    assert applied.counts == (7, 2, 1, 3, 4, 3)
    assert applied.locate
    _, whole = resolve(problem, "images 1-2: rotation,position fixed")
    assert not whole.locate


def test_bounds_and_priors_of_the_parameters_that_exist():
    problem = mixed()
    _, applied = resolve(
        problem, "cameras *: k1 in [-1, 1]", "camera 2: f prior 5 %", "camera 2: k1 prior 10 %"
    )
    assert applied.bounds == {(2, 4): (-1.0, 1.0), (4, 4): (-1.0, 1.0)}
    fx, fy, k1 = applied.priors
    assert (fx.parameter, fx.sigma, fx.relative) == ("fx", (0.05,), True)
    assert (fy.parameter, fy.value) == ("fy", (problem.camera_params[1, 1],))
    assert (k1.relative, k1.sigma) == (False, (abs(problem.camera_params[1, 4]) * 10 / 100,))


def test_a_part_leaves_the_rest_alone():
    problem = mixed()
    part = {"camera": {1, 2}, "image": {1, 2}, "point": {1}}
    start, applied = resolve(
        problem,
        "cameras *: f prior 2 %",
        "image 1,5: rotation prior sigma 1",
        "points *: position prior sigma 1",
        part=part,
    )
    assert start is problem
    subjects = [prior.subject for prior in applied.priors]
    assert subjects == [("camera", 1), ("camera", 2), ("camera", 2), ("image", 1), ("point", 1)]


def test_thousands_of_cameras_at_once():
    count = 5000
    problem = scenes.make_problem(num_images=4, num_points=8)
    big = problem.replace(
        camera_ids=2**40 + np.arange(count),
        camera_models=["OPENCV"] * count,
        camera_params=np.tile([1000.0, 1000, 400, 300, 0, 0, 0, 0], (count, 1)),
        camera_sizes=np.tile([800, 600], (count, 1)),
    )
    _, applied = resolve(big, "cameras *: f prior 2 %", f"cameras {2**40}: k1,k2,p1,p2 fixed")
    assert len(applied.priors) == 2 * count
    assert applied.held_params == {2**40: {4, 5, 6, 7}}


def test_nothing_and_other_objects():
    problem = mixed()
    assert apply((), problem, bundle.SolveOptions()) == (problem, None)
    assert apply(Constraints(), problem, bundle.SolveOptions()) == (problem, None)
    with pytest.raises(bundle.InputError, match="constraints"):
        bundle.solve(problem, constraints=5)
