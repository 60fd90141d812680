"""Flags of one kind of input or scene; they are refused for other kinds."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Collection, Iterable
from typing import Any

from bundle.cli.dispatch import FLIGHT
from bundle.cli.option_flags import add_options, choice_word
from bundle.errors import InputError
from bundle.interface.option_class import Options
from bundle.interface.option_classes import option_class

_OF_ALL = (
    *("input", "inputs", "output", "json", "quiet", "verbose", "overwrite"),
    *("command", "kind", "flags", "taken"),
)


def add_pose_graph_flags(
    parser: argparse.ArgumentParser,
    names: Collection[str] | None = None,
    title: str = "pose graphs (.g2o), beside backend, loss, trust region, tolerances and threads",
) -> None:
    """Add the options that only pose graphs have, and extend the choices of shared options.

    Args:
        parser: parser of the command.
        names: names of the options; None: all.
        title: title of their group in the help.
    """
    for field in dataclasses.fields(option_class("PoseGraphOptions")):  # type: ignore[arg-type]
        if names is None or field.name in names:
            _widen(parser, field, "pose graphs")
    own = [field.name for field in _only("PoseGraphOptions", "SolveOptions")]
    chosen = [name for name in own if names is None or name in names]
    add_options(parser, "PoseGraphOptions", title, chosen)


def _widen(parser: argparse.ArgumentParser, field: dataclasses.Field[Any], kind: str) -> None:
    """Extend the flag of another option class by the choices of this class."""
    action = parser._option_string_actions.get(field.metadata["flag"])
    if action is None or action.choices is None:
        return
    known = list(action.choices)
    words = [choice_word(word) for word in field.metadata["choices"]]
    added = [word for word in words if word not in known]
    if added:
        action.choices = [*known, *added]
        action.help = f"{action.help}; for {kind} also {', '.join(added)}"


def add_flight_flags(parser: argparse.ArgumentParser) -> None:
    """Add the scene "flight" and its own options."""
    action = parser._option_string_actions["--scene"]
    action.choices = [*(action.choices or ()), FLIGHT]
    action.help = (
        f"{action.help}; {FLIGHT}: a visual-inertial sequence, samples of an IMU and tracks, with "
        "ground_truth.csv in its folder"
    )
    add_options(
        parser,
        "FlightOptions",
        f"options of --scene {FLIGHT}, beside --pixel-noise, --outlier-share and --seed",
        [field.name for field in _only("FlightOptions", "SceneOptions")],
    )


def refuse_flags_of_flights(arguments: argparse.Namespace) -> None:
    """Refuse flags of flights for other scenes.

    Raises:
        InputError: such a flag was given.
    """
    scene = arguments.scene or option_class("SceneOptions")().asdict()["scene"]
    for flag in _given(arguments, _only("FlightOptions", "SceneOptions")):
        raise InputError(f"{flag}: valid only with --scene {FLIGHT}, found --scene {scene}")


def refuse_flags_of_scenes(arguments: argparse.Namespace) -> None:
    """Refuse flags of other scenes for flights.

    Raises:
        InputError: such a flag was given.
    """
    scenes = [f for f in _only("SceneOptions", "FlightOptions") if f.name != "scene"]
    others = [
        f"--{n.replace('_', '-')}" for n in ("format", "ground_truth") if arguments.__dict__[n]
    ]
    for flag in (*_given(arguments, scenes), *others):
        raise InputError(f"{flag}: valid only with other scenes, found --scene {FLIGHT}")


def refuse_flags_of_graphs(arguments: argparse.Namespace) -> None:
    """Refuse flags of pose graphs for reconstructions.

    Raises:
        InputError: such a flag was given.
    """
    for flag in _given(arguments, _only("PoseGraphOptions", "SolveOptions")):
        raise InputError(f"{flag}: valid only with a pose graph, found a reconstruction")


def refuse_flags_of_reconstructions(
    arguments: argparse.Namespace, taken: Collection[str] = (), found: str = "a pose graph"
) -> None:
    """Refuse flags of reconstructions for other inputs.

    Args:
        arguments: parsed command line.
        taken: arguments of this input in addition to those of every command.
        found: kind of the input, for the message.

    Raises:
        InputError: such a flag was given.
    """
    for name, value in vars(arguments).items():
        if name in _OF_ALL or name in taken or value is None or value is False:
            continue
        flag = arguments.flags[name]
        raise InputError(f"{flag}: valid only with a reconstruction, found {found}")


def _only(kind: str, other: str) -> list[dataclasses.Field[Any]]:
    """Return the fields of an option class that another class does not have."""
    shared = {field.name for field in _fields(option_class(other))}
    return [field for field in _fields(option_class(kind)) if field.name not in shared]


def _fields(kind: type[Options]) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(kind)  # type: ignore[arg-type]


def _given(
    arguments: argparse.Namespace, fields: Iterable[dataclasses.Field[Any]]
) -> Iterable[str]:
    """Yield the flags of these fields that the command line has."""
    for field in fields:
        if getattr(arguments, field.name, None) is not None:
            yield field.metadata["flag"]
