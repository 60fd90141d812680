"""The repair of a model before further tests: its options, its priors, and its commands."""

from types import SimpleNamespace

import pytest

from bundle import InputError
from bundle.judging.findings import repaired as module
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.repaired import is_affordable, repaired
from tests.scenes import make_problem

PRIORS = ("a prior",)


def repair(monkeypatch, *repairs, end="CONVERGENCE", **how):
    """Return the model before, the solve's arguments by name, and the repaired model."""
    problem = make_problem(num_images=3, num_points=20)
    command = NextCommand("INPUT", "OUTPUT", ("--loss", "huber", "--rounds", "2"))
    before = Measured(whole=problem, command=command, priors=PRIORS, lens_sigmas=("sigmas", 1.0))
    asked = {}

    def solved(measured, start, options, priors):
        assert measured is before
        asked.update(start=start, options=options, priors=priors)
        if end == "refused":
            raise InputError("no start")
        summary = SimpleNamespace(termination_type=end)
        return SimpleNamespace(problem=start, summary=summary)

    monkeypatch.setattr(module, "solved", solved)
    return before, asked, repaired(before, *repairs, **how)


@pytest.mark.parametrize("with_priors", [True, False])
def test_priors_take_part_if_asked(monkeypatch, with_priors):
    _, asked, found = repair(monkeypatch, with_priors=with_priors)
    assert asked["priors"] == found.priors == (PRIORS if with_priors else ())
    assert found.is_minimum and found.lens_sigmas is None


@pytest.mark.parametrize(("is_bent", "limits"), [(False, (50, 1e-4)), (True, (200, 1e-6))])
def test_a_bent_model_has_more_steps(monkeypatch, is_bent, limits):
    before, asked, found = repair(monkeypatch, is_bent=is_bent)
    options = asked["options"]
    assert (options.max_num_iterations, options.function_tolerance) == limits
    assert (options.loss, options.loss_scale) == ("cauchy", pytest.approx(2 * before.scale))
    assert found.options == options


@pytest.mark.parametrize(
    ("repairs", "model", "flags"),
    [
        ((), "SIMPLE_RADIAL", "--rounds 2 --loss cauchy"),
        (("RADIAL",), "RADIAL", "--loss huber --rounds 2 --camera-model RADIAL"),
        (("", "rows"), "SIMPLE_RADIAL", "--loss huber --rounds 2 --rolling-shutter rows"),
    ],
)
def test_commands_begin_with_the_same_repair(monkeypatch, repairs, model, flags):
    _, asked, found = repair(monkeypatch, *repairs)
    assert found.command.refine() == f"bundle refine INPUT -o OUTPUT {flags}"
    assert set(asked["start"].camera_models) == {model}
    shutter = asked["start"].rolling_shutter
    assert (shutter is not None) == (repairs[1:] == ("rows",))


@pytest.mark.parametrize(
    ("repairs", "end", "is_usable"),
    [
        ((), "NO_CONVERGENCE", False),
        (("RADIAL",), "NO_CONVERGENCE", True),
        ((), "refused", False),
        (("RADIAL",), "refused", False),
    ],
)
def test_a_loss_alone_converges_or_repairs_nothing(monkeypatch, repairs, end, is_usable):
    assert (repair(monkeypatch, *repairs, end=end)[2] is not None) == is_usable


@pytest.mark.parametrize(
    ("observations", "images", "expected"),
    [(50_000, 100, True), (50_001, 100, False), (50_000, 101, False)],
)
def test_small_models_are_solved_again(observations, images, expected):
    whole = SimpleNamespace(num_observations=observations, num_images=images)
    assert is_affordable(SimpleNamespace(whole=whole)) == expected
