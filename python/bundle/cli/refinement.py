"""A run of `bundle refine` on a reconstruction: its options, checked in the order of the help."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.cli.declarations import READING
from bundle.cli.error_lines import complain
from bundle.cli.inertial_flags import InertialFiles, inertial_given
from bundle.cli.option_flags import options_given
from bundle.cli.problem_edits import rules_as_options
from bundle.cli.run import Run, given_flags, repeated_flags
from bundle.errors import InputError, shown
from bundle.interface.camera_edit_options import LensOptions, ShutterOptions
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
from bundle.judging.findings.next_command import NextCommand
from bundle.solving.rounds.plan import RunPlan

if TYPE_CHECKING:
    from bundle.editing.camera_sharing import CameraEdits
    from bundle.georeference.measurements import MeasurementErrors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.model.problem import Problem
    from bundle.solving.slices.sliced_refinement import SlicedRefinement


class Refinement(Run):
    """Run of `bundle refine` on a reconstruction; ``found`` is the result of the solve.

    :meth:`check` sets the options, ``bundle.cli.refine_input`` what belongs to INPUT, and
    ``bundle.cli.refine`` the result.
    """

    local: LocalOptions  # images to refine while all others are constant
    rounds: RoundOptions  # rounds of adjusting and filtering
    held_out: HoldOutOptions  # share of the observations that a second fit holds out
    loops: LoopOptions  # loops to close before the solve
    lenses: LensOptions  # cameras of the output
    shutters: ShutterOptions  # rolling shutters
    imu: InertialFiles | None  # files of an IMU, or None
    checkpoints: CheckpointOptions  # checkpoint files, for a run that may be killed
    disk: OutOfCoreOptions  # folder for observations and points on disk

    problem: Problem  # INPUT with the requested cameras and rigs
    edits: CameraEdits | None  # changes of its cameras; None without any
    output: dict[str, str]  # path and format of OUTPUT
    align: bool | None  # True to move the problem to its priors
    place: dict[str, Any] | None  # content of the georeference.json next to INPUT, or None
    # refinement by processes that read one slice each; None: one process reads all
    sliced: SlicedRefinement | None
    closed: LoopClosing | None  # problem with closed loops, or None
    inertial: InertialAdjustment | None  # result with an IMU, or None
    measured: tuple[MeasurementErrors, ...]  # errors of the result at its measurements

    def check(self) -> None:
        """Read and check the options; images given by name follow when INPUT is open."""
        arguments = self.arguments
        take_colmap_options(arguments)
        self.options = self.given(SolveOptions)
        self.local = self.given(LocalOptions)
        self.rounds = _rounds_given(arguments)
        self.held_out = _share_given(arguments)
        self.check_knowledge(self.options.refine, page=arguments.html is not None)
        self.loops = self.given(LoopOptions)
        if self.loops.loops is not None and self.local.only_images is not None:
            raise InputError(
                "--loops: not valid with --only-images, which leaves all other images in place"
            )
        self.lenses = self.given(LensOptions)
        self.shutters = self.given(ShutterOptions)
        self.imu = inertial_given(arguments)
        self.checkpoints = _checkpoints_given(arguments)
        self.disk = self.given(OutOfCoreOptions)

    @property
    def rounds_plan(self) -> RunPlan:
        """Rounds of the run, its checkpoints, and its held-out observations."""
        return RunPlan(rounds=self.rounds, held_out=self.held_out, **self.checkpoints.asdict())

    @property
    def num_adjustments(self) -> int:
        """Most adjustments of the run."""
        return self.rounds.num_rounds + 1

    @property
    def command(self) -> NextCommand:
        """The command line of this run, which findings change."""
        return NextCommand(self.source, self.target, repeated_flags(self.arguments))

    def flags_beyond(self, *plain: str) -> list[str]:
        """Return the flags that need more than one solve of the complete, unchanged INPUT.

        ``plain``: names of options that are served, too.
        """
        parts = (
            *(self.local, self.rounds, self.held_out, self.georeference, self.loops, self.lenses),
            *(self.shutters, self.rules, self.checkpoints),
        )
        changed = {name for part in parts for name in part.changed()} - {*plain}
        flags = {self.arguments.flags[name] for name in changed}
        flags |= {*given_flags(self.arguments, (*READING, "rig_config", "html", "imu"))}
        flags |= {"--check-gradients"} if self.arguments.check_gradients else set()
        return sorted(flags)

    def options_beside(self) -> dict[str, Any]:
        """Return, for the report, the given options in addition to those of the solve."""
        rounds = self.rounds.asdict() if self.rounds.num_rounds else {}
        local = {} if self.local.only_images is None else self.local.asdict()
        held_out = self.held_out.asdict() if self.held_out.hold_out else {}
        inertial = {} if self.imu is None else vars(self.imu)
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
