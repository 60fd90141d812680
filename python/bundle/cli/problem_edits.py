"""Changes of a problem before its solve: cameras, rigs, loops, and rules for parameters.

Each change needs modules that most runs do not use; they are imported when needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bundle.cli.option_flags import naming_flags
from bundle.errors import InputError
from bundle.interface.camera_edit_options import LensOptions, RuleOptions, ShutterOptions
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import LoopOptions

if TYPE_CHECKING:
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.model.problem import Problem
    from bundle.solving.constraints.rule_list import Constraints


def with_rigs(problem: Problem, path: str | None) -> Problem:
    """Return the problem with the rigs of a file; unchanged without a file."""
    if path is None:
        return problem
    from bundle.editing.rig_config import apply_rig_config

    return apply_rig_config(problem, path)


def with_shutters(
    problem: Problem, given: ShutterOptions, options: SolveOptions
) -> tuple[Problem, SolveOptions]:
    """Return the problem with the given rolling shutters, and the options with their readout."""
    if not given.changed():
        return problem, options
    from bundle.editing import rolling_shutters

    names = ShutterOptions, SolveOptions
    with naming_flags(*names, refine_readout="--readout estimate"):
        return rolling_shutters.with_shutters(problem, given, options)


def cameras_edited(
    given: LensOptions, problem: Problem, *, keep_scale: bool = False
) -> CameraEdits | None:
    """Return the problem with the requested changes of cameras; None without any.

    ``keep_scale``: a solve follows that may move all images.
    """
    if not given.changed():
        return None
    if given.share_cameras is not None and given.split_cameras:
        raise InputError("--split-cameras: not valid with --share-cameras, found both")
    from bundle.editing.camera_sharing import edit_cameras

    share = False if given.share_cameras is None else given.share_cameras
    with naming_flags(model="--camera-model", camera_ids="--share-cameras"):
        return edit_cameras(
            problem, given.camera_model, share=share, split=given.split_cameras,
            keep_scale=keep_scale,
        )  # fmt: skip


def loops_closed(given: LoopOptions, problem: Problem) -> LoopClosing | None:
    """Return the problem with closed loops; None if no loops were given."""
    if given.loops is None:
        return None
    from bundle.graphs.loops.loop_graph import close_loops

    with naming_flags(loss="--loop-loss", loss_scale="--loop-loss-scale"):
        return close_loops(
            problem, given.loops, loss=given.loop_loss, loss_scale=given.loop_loss_scale
        )


def rules_of(given: RuleOptions) -> Constraints | tuple[()]:
    """Return the rules of the file, followed by those of the command line."""
    if given.rules is None and given.constraints is None:
        return ()
    from bundle.solving.constraints.rule_list import Constraints, parse_rule

    texts = given.rules or ()
    rules = [
        parse_rule(text, f"--set {number}" if len(texts) > 1 else "--set")
        for number, text in enumerate(texts, 1)
    ]
    if given.constraints is None:
        return Constraints(rules)
    return Constraints.read(given.constraints) + rules


def rules_as_options(given: RuleOptions) -> dict[str, Any]:
    """Return the rules as given, for a report."""
    named = {"set": given.rules, "constraints": given.constraints}
    return {name: value for name, value in named.items() if value is not None}
