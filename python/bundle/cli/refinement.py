"""Request of `bundle refine` for a reconstruction: the checked values of the command line.

Only this file reads the arguments; all later steps use typed options.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Set
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.base.records import dataclass
from bundle.cli.declarations import read_options
from bundle.cli.error_lines import complain
from bundle.cli.georeferencing import georeference_given, prior_flags
from bundle.cli.inertial_flags import InertialFiles, inertial_given
from bundle.cli.option_flags import naming_flags, options_given
from bundle.cli.problem_edits import rules_as_options, rules_of
from bundle.cli.run import repeated_flags
from bundle.errors import InputError, shown
from bundle.interface.camera_edit_options import LensOptions, RuleOptions, ShutterOptions
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.judging_options import HoldOutOptions
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import LoopOptions
from bundle.interface.round_options import (
    DEFAULT_SHARE,
    NUM_TRACK_ROUNDS,
    CheckpointOptions,
    LocalOptions,
    OutOfCoreOptions,
    RoundOptions,
)
from bundle.io.formats.read_options import ReadOptions
from bundle.solving.rounds.plan import RunPlan

if TYPE_CHECKING:
    from bundle.solving.constraints.rule_list import Constraints

OF_PLAIN = {
    "arguments",
    "source",
    "target",
    "given",
    "checkpoints",
    "options",
    "constraints",
    "disk",
}
"""Fields that a refinement in slices serves, too; any other makes it more than plain."""


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """The command line, with the values that were checked or made of it."""

    arguments: argparse.Namespace  # parsed command line
    source: str  # path of INPUT
    reading: ReadOptions  # facts that the file of INPUT lacks
    target: str  # path of OUTPUT
    rig_config: str | None  # path of a rig configuration, or None
    page: str | None  # path of the report page, or None
    check_gradients: bool  # True to check the Jacobians first
    options: SolveOptions  # options of the solve, without images given by name
    local: LocalOptions  # images to refine while all others are constant
    rounds: RoundOptions  # rounds of adjusting and filtering
    held_out: HoldOutOptions  # share of the observations that a second fit holds out
    georeference: GeoreferenceOptions  # options of positions and control points
    loops: LoopOptions  # loops to close before the solve
    lenses: LensOptions  # cameras of the output
    shutters: ShutterOptions  # rolling shutters
    rules: RuleOptions  # rules as given
    constraints: Constraints | tuple[()]  # the parsed rules
    inertial: InertialFiles | None  # files of an IMU, or None
    checkpoints: CheckpointOptions  # checkpoint files, for a run that may be killed
    disk: OutOfCoreOptions  # folder for observations and points on disk
    given: tuple[str, ...]  # flags that the next command of a finding repeats

    @staticmethod
    def of(arguments: argparse.Namespace) -> Refinement:
        """Return the request, checked in the order of the help."""
        take_colmap_options(arguments)
        options = options_given(arguments, SolveOptions, names_follow=True)
        local = options_given(arguments, LocalOptions)
        rounds = _rounds_given(arguments)
        georeference = georeference_given(
            arguments,
            options.refine,
            page=arguments.html is not None,
            only_images=local.only_images,
        )
        loops = options_given(arguments, LoopOptions)
        if loops.loops is not None and local.only_images is not None:
            raise InputError(
                "--loops: not valid with --only-images, which leaves all other images in place"
            )
        rules = options_given(arguments, RuleOptions)
        constraints = rules_of(rules)
        return Refinement(
            arguments=arguments,
            source=arguments.input,
            reading=read_options(arguments),
            target=arguments.output,
            rig_config=arguments.rig_config,
            page=arguments.html,
            check_gradients=arguments.check_gradients,
            options=options,
            local=local,
            rounds=rounds,
            held_out=_share_given(arguments),
            georeference=georeference,
            loops=loops,
            lenses=options_given(arguments, LensOptions),
            shutters=options_given(arguments, ShutterOptions),
            rules=rules,
            constraints=constraints,
            inertial=inertial_given(arguments),
            checkpoints=_checkpoints_given(arguments),
            disk=options_given(arguments, OutOfCoreOptions),
            given=repeated_flags(arguments),
        )

    @property
    def plan(self) -> RunPlan:
        """Rounds of the run, its checkpoints, and its held-out observations."""
        return RunPlan(rounds=self.rounds, held_out=self.held_out, **self.checkpoints.asdict())

    @property
    def num_adjustments(self) -> int:
        """Most adjustments of the run."""
        return self.rounds.num_rounds + 1

    def naming_flags(self) -> AbstractContextManager[None]:
        """Return a context whose errors about options name their flags."""
        classes = (SolveOptions, RoundOptions, LocalOptions, CheckpointOptions, HoldOutOptions)
        return naming_flags(*classes, **prior_flags(self.georeference))

    @property
    def is_plain(self) -> bool:
        """True for a single solve of the complete, unchanged INPUT without further steps."""
        return not self.steps_beyond()

    def steps_beyond(self, plain: Set[str] = frozenset(OF_PLAIN)) -> tuple[str, ...]:
        """Return the sorted names of options that need more than a plain solve."""
        found: list[str] = []
        for name in set(self.__dataclass_fields__) - plain:
            value = getattr(self, name)
            changed = value.changed() if hasattr(value, "changed") else bool(value)
            found += changed if isinstance(changed, dict) else [name] if changed else []
        return tuple(sorted(found))

    def options_beside(self) -> dict[str, Any]:
        """Return, for the report, the given options in addition to those of the solve."""
        rounds = self.rounds.asdict() if self.rounds.num_rounds else {}
        local = {} if self.local.only_images is None else self.local.asdict()
        held_out = self.held_out.asdict() if self.held_out.hold_out else {}
        inertial = {} if self.inertial is None else vars(self.inertial)
        parts = self.georeference, self.loops, self.lenses, self.shutters
        return {
            **rounds,
            **held_out,
            **local,
            **inertial,
            **{name: value for part in parts for name, value in part.changed().items()},
            **self.checkpoints.changed(),
            **self.disk.changed(),
            **rules_as_options(self.rules),
        }


def _rounds_given(arguments: argparse.Namespace) -> RoundOptions:
    """Return the rounds; with a database, --rounds has a default."""
    if arguments.database is None:
        return options_given(arguments, RoundOptions)
    limits = ("max_error", "min_angle", "min_track_length")
    given = options_given(arguments, RoundOptions, beside=limits)
    is_default = arguments.num_rounds is None
    return dataclasses.replace(given, num_rounds=NUM_TRACK_ROUNDS) if is_default else given


def _share_given(arguments: argparse.Namespace) -> HoldOutOptions:
    """Return the held-out share; with a database, --hold-out has a default."""
    given = options_given(arguments, HoldOutOptions, beside=("hold_out_seed",))
    if arguments.database is None:
        return options_given(arguments, HoldOutOptions)
    is_default = arguments.hold_out is None
    return dataclasses.replace(given, hold_out=DEFAULT_SHARE) if is_default else given


def _checkpoints_given(arguments: argparse.Namespace) -> CheckpointOptions:
    """Return the checkpoint files, and print a note if a run starts over."""
    given = options_given(arguments, CheckpointOptions)
    if given.resume is not None and not Path(given.resume).exists():
        complain(f"note: {shown(given.resume)} does not exist; the run starts with the input")
    return given


SHORTEST_TRACK = 2  # length of the shortest tracks that COLMAP has


def take_colmap_options(arguments: argparse.Namespace) -> None:
    """Set the options that the command line lacks from the file of --colmap-options, if given."""
    path = arguments.colmap_options
    if path is None:
        return
    from bundle.io.database_images import read_project_ini  # for this flag only

    asked = read_project_ini(path)
    if asked.min_track_length > SHORTEST_TRACK:
        raise InputError(
            f"{shown(path)}: min_track_length: expected at most {SHORTEST_TRACK}, found "
            f"{asked.min_track_length}; to delete short tracks, use --rounds with --min-track"
        )
    if asked.asks_for_gpu:
        complain(f"note: {shown(path)}: use_gpu: there is no GPU solver; the CPU is used")
    for field in dataclasses.fields(SolveOptions):
        value = getattr(asked.options, field.name)
        if value != field.default and getattr(arguments, field.name) is None:
            setattr(arguments, field.name, value)
    if asked.constant_rotations:
        arguments.rules = [*(arguments.rules or ()), "images *: rotation fixed"]
