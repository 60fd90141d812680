"""Option classes of the command line: one table, sound declarations, the defaults of functions."""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import sys

import pytest

from bundle.cli.main import command_parser
from bundle.cli.option_flags import READERS, add_fields, options_given
from bundle.cli.parser import Parser
from bundle.errors import InputError
from bundle.georeference.alignment import align
from bundle.georeference.control_point import parse_sigma
from bundle.georeference.measurements import ROWS
from bundle.georeference.survey_priors import gcp_priors, gps_priors
from bundle.graphs.loops.loop_graph import close_loops
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.option_class import OPTION_CLASSES, Options, option_class
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import LoopOptions, PoseGraphOptions
from bundle.interface.round_options import CheckpointOptions, LocalOptions, RoundOptions

NAMED = [option_class(name) for name in OPTION_CLASSES]
CLASSES = [*NAMED, *(row.options for row in ROWS if row.options is not None)]


def descendants(kind):
    for child in kind.__subclasses__():
        yield child
        yield from descendants(child)


def test_the_table_has_every_class():
    kinds = (kind for kind in descendants(Options) if kind.__module__.startswith("bundle."))
    # Classes that rows of measurements compose are no names of a module.
    own = {kind for kind in kinds if hasattr(sys.modules[kind.__module__], kind.__name__)}
    assert own == set(CLASSES)
    assert [kind.__name__ for kind in NAMED] == list(OPTION_CLASSES)


@pytest.mark.parametrize("kind", CLASSES)
def test_declarations_are_sound(kind):
    fields = dataclasses.fields(kind)
    names = {field.name for field in fields}
    flags = [field.metadata["flag"] for field in fields]
    assert len(set(flags)) == len(flags)
    for field in fields:
        meta = field.metadata
        assert meta["flag"].startswith("--") and not meta["help"].endswith(".")
        assert set(meta["needs"]) <= names
        assert meta["only_with"] is None or meta["only_with"][0] in names
        assert not meta["value"] or meta["value"] in {*READERS, "several"}
    assert kind() == kind(**kind().asdict())
    assert not kind().changed()
    assert all(f"{name}: " in kind.__doc__ for name in names)


def test_every_option_of_a_class_is_a_flag_of_a_command():
    flags = {flag for command in command_parser().commands().values() for flag in command.flags()}
    for kind in CLASSES:
        assert {field.metadata["flag"] for field in dataclasses.fields(kind)} <= flags, kind


def given(kind, *words, **how):
    parser = Parser(prog="test")
    add_fields(parser, kind)
    return options_given(parser.parse_args(words, argparse.Namespace()), kind, **how)


@pytest.mark.parametrize(
    ("kind", "words", "message"),
    [
        (RoundOptions, ("--max-error", "3"), "--max-error: valid only with --rounds"),
        (RoundOptions, ("--rounds", "0", "--min-track", "3"), "--min-track: valid only with"),
        (LoopOptions, ("--loop-loss", "huber"), "--loop-loss: valid only with --loops"),
        (LocalOptions, ("--rest", "fixed"), "--rest: valid only with --only-images"),
        (CheckpointOptions, ("--checkpoint-interval", "20"), "only with --checkpoint or --resume"),
        (GeoreferenceOptions, ("--prior-loss", "huber"), "only with --gcp, --gps, --gravity"),
        (GeoreferenceOptions, ("--gcp-sigma", "1", "--antenna", "x"), "--antenna: valid only with"),
    ],
)
def test_an_option_without_the_one_it_needs_is_refused(kind, words, message):
    with pytest.raises(InputError, match=message):
        given(kind, *words)
    names = [field.name for field in dataclasses.fields(kind)]
    assert given(kind, *words, beside=names).changed() or "20" in words or "fixed" in words


def test_needed_options_serve_any_that_need_them():
    found = given(CheckpointOptions, "--resume", "a", "--checkpoint-interval", "3")
    assert found.changed() == {"resume": "a", "checkpoint_interval": 3}
    found = given(GeoreferenceOptions, "--gcp", "a", "--prior-loss", "huber", "--gcp-sigma", "1/2")
    assert found.changed() == {"gcp": "a", "prior_loss": "huber", "gcp_sigma": "1/2"}


@pytest.mark.parametrize("function", [gps_priors, gcp_priors, align])
def test_georeference_has_the_defaults_of_the_functions(function):
    shown = inspect.signature(function).parameters
    for field in dataclasses.fields(GeoreferenceOptions):
        if field.name not in shown or field.default is None:
            continue
        default = shown[field.name].default
        if field.name.endswith("_sigma") and isinstance(field.default, str):
            assert tuple(parse_sigma(field.name, field.default)) == tuple(default)
        elif field.name == "antenna":
            assert tuple(GeoreferenceOptions().lever_arm) == tuple(default)
        else:
            assert field.default == default, field.name


def test_loops_have_the_defaults_of_the_function():
    shown = inspect.signature(close_loops).parameters
    assert LoopOptions().loop_loss == shown["loss"].default
    assert LoopOptions().loop_loss_scale == shown["loss_scale"].default


def test_the_same_option_has_the_declaration_of_the_other_class_but_what_is_changed():
    changed = {"gradient_tolerance": {"help"}}
    for name in ("max_num_iterations", "function_tolerance", "gradient_tolerance", "num_threads"):
        one, other = (
            kind.__dataclass_fields__[name].metadata for kind in (PoseGraphOptions, SolveOptions)
        )
        assert {key for key in one if one[key] != other[key]} == changed.get(name, set())
    assert "typical information" in " ".join(PoseGraphOptions.__doc__.split())
    assert PoseGraphOptions().function_tolerance == 1e-10 != SolveOptions().function_tolerance
