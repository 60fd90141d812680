"""Flags of commands that take a pose graph as well as a reconstruction."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Collection

from bundle.cli.option_flags import add_options as add_option_group
from bundle.cli.option_flags import choice_word
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions

__all__ = ["add_pose_graph_flags", "refuse_flags_of_graphs", "refuse_flags_of_reconstructions"]

_OF_ALL = ("input", "inputs", "output", "json", "quiet", "overwrite", "run")
_SHARED = {field.name for field in dataclasses.fields(SolveOptions)}
_ONLY_GRAPHS = [
    field for field in dataclasses.fields(PoseGraphOptions) if field.name not in _SHARED
]


def add_pose_graph_flags(
    parser: argparse.ArgumentParser,
    names: Collection[str] | None = None,
    title: str = "pose graphs (.g2o), beside backend, loss, trust region, tolerances and threads",
) -> None:
    """Add the options of pose graphs that a reconstruction has not, and widen those of both.

    Args:
        parser: of the command.
        names: of the options; None: all.
        title: of their group in the help.
    """
    for field in dataclasses.fields(PoseGraphOptions):
        if names is not None and field.name not in names:
            continue
        action = parser._option_string_actions.get(field.metadata["flag"])
        if action is None or action.choices is None:
            continue
        known = list(action.choices)
        more = [choice_word(word) for word in field.metadata["choices"]]
        added = [word for word in more if word not in known]
        if added:
            action.choices = [*known, *added]
            action.help = f"{action.help}; for pose graphs also {', '.join(added)}"
    add_option_group(
        parser,
        PoseGraphOptions,
        title,
        [field.name for field in _ONLY_GRAPHS if names is None or field.name in names],
    )


def refuse_flags_of_graphs(arguments: argparse.Namespace) -> None:
    """Refuse, for a reconstruction, what only a pose graph has.

    Raises:
        InputError: such a flag was given.
    """
    for field in _ONLY_GRAPHS:
        if getattr(arguments, field.name, None) is not None:
            raise InputError(
                f"{field.metadata['flag']}: expected with a pose graph only, found a reconstruction"
            )


def refuse_flags_of_reconstructions(
    arguments: argparse.Namespace, taken: Collection[str] = ()
) -> None:
    """Refuse, for a pose graph, what only a reconstruction has.

    Args:
        arguments: of the command line.
        taken: arguments beside those of every command that a pose graph has.

    Raises:
        InputError: such a flag was given.
    """
    from bundle.interface.round_options import RoundOptions

    flags = {
        field.name: field.metadata["flag"]
        for kind in (SolveOptions, RoundOptions)
        for field in dataclasses.fields(kind)
    } | {"rules": "--set"}  # of arguments, where it is not their name
    for name, value in vars(arguments).items():
        if name in _OF_ALL or name in taken or value is None or value is False or value == []:
            continue
        flag = flags.get(name, f"--{name.replace('_', '-')}")
        raise InputError(f"{flag}: expected with a reconstruction only, found a pose graph")
