"""Flags of rules about what is fixed, bounded, shared or known."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from bundle.cli.path_checks import a_path

if TYPE_CHECKING:
    from bundle.solving.constraints.rule_list import Constraints

__all__ = ["add_constraint_flags", "as_options", "constraints_given"]


def add_constraint_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of rules."""
    group = parser.add_argument_group(
        "constraints",
        "What is known beside the pixels, such as --set 'cameras *: f prior 2 %' or --set "
        "'camera 3: cx,cy fixed'. Focal lengths and the principal point are in pixels, positions "
        "in the unit of the model (metres with --gps), rotations in degrees.",
    )
    group.add_argument(
        "--set",
        metavar="RULE",
        action="append",
        dest="rules",
        help="hold, bound, share or pull parameters: TARGET: NAMES fixed | NAMES prior [VALUE] "
        "sigma S | NAMES prior [VALUE] P %% | NAMES in [MIN, MAX] | share NAMES | NAME/NAME fixed; "
        'TARGET: camera 3, cameras 1-4, cameras *, image 7, image "left/*.jpg", point 12; NAMES: '
        "COLMAP's of the camera model, or position and rotation; may be given several times "
        "(default: none)",
    )
    group.add_argument(
        "--constraints",
        metavar="FILE",
        type=a_path,
        help="the same rules from a file, one a line; # begins a comment (default: none)",
    )


def constraints_given(arguments: argparse.Namespace) -> Constraints | tuple[()]:
    """Return the rules of the file, then those of the command line.

    Raises:
        InputError: one is no rule; the message names the file and line, or which --set it is.
        OSError: the file cannot be read.
    """
    if arguments.rules is None and arguments.constraints is None:
        return ()
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rule_text import parse_rule

    rules = [
        parse_rule(text, f"--set {number}" if len(arguments.rules) > 1 else "--set")
        for number, text in enumerate(arguments.rules or (), 1)
    ]
    if arguments.constraints is None:
        return Constraints(rules)
    return Constraints.read(arguments.constraints) + rules


def as_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the flags for the report: what was given, as it was given."""
    given = {"set": arguments.rules, "constraints": arguments.constraints}
    return {name: value for name, value in given.items() if value is not None}
