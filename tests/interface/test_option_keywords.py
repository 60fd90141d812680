"""Typed keywords and signatures: the same names, types and defaults as the option classes.

The stub of the keywords is for type checkers; here it runs as a module.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import get_args, get_origin, get_type_hints

import pytest

import bundle
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.scene_options import FlightOptions, SceneOptions
from bundle.interface.window_options import WindowOptions

CLASSES = (SolveOptions, PoseGraphOptions, SceneOptions, FlightOptions, WindowOptions)
SOURCE = Path(bundle.interface.__path__[0], "option_keywords.pyi").read_text()
option_keywords = ModuleType("option_keywords")
exec(compile(SOURCE, "option_keywords.pyi", "exec", dont_inherit=True), vars(option_keywords))


def keywords(kind):
    return getattr(option_keywords, kind.__name__.replace("Options", "Keywords"))


@pytest.mark.parametrize("kind", CLASSES)
def test_names_and_order_agree(kind):
    names = [field.name for field in dataclasses.fields(kind)]
    assert list(keywords(kind).__annotations__) == names
    assert keywords(kind).__total__ is False


@pytest.mark.parametrize("kind", CLASSES)
def test_types_agree(kind):
    given, held = get_type_hints(keywords(kind)), get_type_hints(kind)
    for field in dataclasses.fields(kind):
        if get_origin(held[field.name]) is not tuple:
            assert given[field.name] is held[field.name] is type(field.default), field.name
            continue
        first, last = get_args(held[field.name])[0], get_args(held[field.name])[-1]
        assert get_origin(given[field.name]) is (Iterable if last is ... else Sequence), field.name
        assert get_args(given[field.name]) == (first,)


@pytest.mark.parametrize("kind", CLASSES)
def test_defaults_agree(kind):
    body = SOURCE.partition(f"class {keywords(kind).__name__}(")[2].partition("\nclass ")[0]
    said = dict(re.findall(r"^    (\w+): [^#\n]+  # (.+)$", body, re.MULTILINE))
    assert said == {field.name: repr(field.default) for field in dataclasses.fields(kind)}


def test_every_keyword_type_has_a_class():
    given = {name for name in vars(option_keywords) if name.endswith("Keywords")}
    assert given == {keywords(kind).__name__ for kind in CLASSES}


def test_a_signature_lists_the_options_after_the_arguments_of_a_function():
    @takes_options(SolveOptions)
    def function(problem, *, loss="own", **changes):
        return problem, loss, changes

    shown = inspect.signature(function).parameters
    names = [field.name for field in dataclasses.fields(SolveOptions) if field.name != "loss"]
    assert list(shown) == ["problem", "loss", *names]
    assert shown["loss"].default == "own"
    assert shown["gauge"].default == "auto"
    assert function(1, gauge="none") == (1, "own", {"gauge": "none"})


@pytest.mark.parametrize(
    ("function", "kind"),
    [
        (bundle.solve, SolveOptions),
        (bundle.Solver, SolveOptions),
        (bundle.solve_rounds, SolveOptions),
        (bundle.compare, SolveOptions),
        (bundle.covariance, SolveOptions),
        (bundle.diagnose, SolveOptions),
        (bundle.inspect, SolveOptions),
        (bundle.gauge_freedom, SolveOptions),
        (bundle.FactorGraph.solve, SolveOptions),
        (bundle.synthesize, SceneOptions),
        (bundle.synthesize_flight, FlightOptions),
        (bundle.run_odometry, WindowOptions),
        (bundle.SlidingWindow, WindowOptions),
    ],
)
def test_functions_show_every_option_that_they_take(function, kind):
    shown = inspect.signature(function).parameters
    assert {field.name for field in dataclasses.fields(kind)} <= set(shown)
    assert not any(parameter.kind is parameter.VAR_KEYWORD for parameter in shown.values())
