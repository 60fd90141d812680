"""`bundle refine` of a reconstruction: INPUT, options, solve, report, OUTPUT."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from bundle.cli.carried_georeference import (
    carry_georeference,
    check_georeference,
    georeference_at,
    write_georeference,
)
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.flags_by_kind import refuse_flags_of_graphs
from bundle.cli.georeference_flags import (
    GEOREFERENCE_FLAGS,
    georeference_given,
    main_flag,
    priors_of,
)
from bundle.cli.option_flags import naming_flags, options_given, with_named_images
from bundle.cli.output import check_replaced, publish, same_images
from bundle.cli.problem_edits import (
    cameras_edited,
    loops_closed,
    rules_as_options,
    rules_of,
    with_rigs,
)
from bundle.cli.progress import Progress
from bundle.cli.sliced_input import sliced_input
from bundle.cli.standard_streams import complain
from bundle.errors import InputError, shown
from bundle.interface.camera_edit_options import LensOptions, RuleOptions
from bundle.interface.georeference_options import GeoreferenceOptions
from bundle.interface.loop_options import LoopOptions
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CheckpointOptions, LocalOptions, RoundOptions
from bundle.io.open import check_target, load, output_format, save
from bundle.reports.terminal.refine import refinement
from bundle.reports.terminal.timing import WallTime
from bundle.solving.request import PartRequest, RunPlan, SolveRequest
from bundle.solving.rounds import solve_rounds

if TYPE_CHECKING:
    from bundle.editing.cameras.edit_record import CameraEdits
    from bundle.georeference.gcp_priors import GcpPriors
    from bundle.georeference.georeferenced import Georeference
    from bundle.georeference.gps_priors import GpsPriors
    from bundle.graphs.loops.loop_closing import LoopClosing
    from bundle.model.problem import Problem
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.result import Result
    from bundle.solving.slices.sliced_refinement import SlicedRefinement

__all__ = ["run"]

STAYED = "Refined again without positions, from where they had placed it."

FLAGS = {
    **GEOREFERENCE_FLAGS,
    "only_images": "--only-images",
    "rest": "--rest",
    "checkpoint": "--checkpoint",
    "checkpoint_interval": "--checkpoint-interval",
    "resume": "--resume",
}
"""Flags of the arguments of :func:`bundle.solve_rounds` that are no options of the solve."""


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """What the command line asks for, as options that were checked.

    Attributes:
        options: of the solve; images given by name follow when the problem is known.
        local: images to refine while the rest stays.
        rounds: of adjusting and filtering.
        georeference: positions and control points.
        loops: to close before the solve.
        lenses: cameras of the output.
        rules: as given on the command line.
        constraints: the rules, parsed.
        checkpoints: files of a run that may be killed.
    """

    options: SolveOptions
    local: LocalOptions
    rounds: RoundOptions
    georeference: GeoreferenceOptions
    loops: LoopOptions
    lenses: LensOptions
    rules: RuleOptions
    constraints: Constraints | tuple[()]
    checkpoints: CheckpointOptions

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> Refinement:
        """Return the options that were given.

        Raises:
            InputError: a value is wrong, or an option has no effect; the message names the flag.
            OSError: the file of the rules cannot be read.
        """
        options = options_given(arguments, SolveOptions, names_follow=True)
        local = options_given(arguments, LocalOptions)
        rounds = options_given(arguments, RoundOptions)
        georeference = georeference_given(
            arguments,
            options.refine,
            page=arguments.html is not None,
            only_images=local.only_images,
        )
        loops = options_given(arguments, LoopOptions)
        if loops.loops is not None and local.only_images is not None:
            raise InputError(
                "--loops: expected without --only-images, which leave the rest in place"
            )
        rules = options_given(arguments, RuleOptions)
        return cls(
            options=options,
            local=local,
            rounds=rounds,
            georeference=georeference,
            loops=loops,
            lenses=options_given(arguments, LensOptions),
            rules=rules,
            constraints=rules_of(rules),
            checkpoints=_checkpoints_given(arguments),
        )

    @property
    def is_plain(self) -> bool:
        """Whether this is one solve of all that INPUT holds, as it is."""
        changed = (self.rounds, self.georeference, self.loops, self.lenses, self.local, self.rules)
        return not any(options.changed() for options in changed)

    def beside(self) -> dict[str, Any]:
        """Return, for the report, the options that were given beside those of the solve."""
        rounds = self.rounds.asdict() if self.rounds.num_rounds else {}
        local = {} if self.local.only_images is None else self.local.asdict()
        return {**rounds, **local, **self.checkpoints.changed(), **rules_as_options(self.rules)}


@dataclass(frozen=True, kw_only=True)
class Opened:
    """INPUT as it goes into the solve, with all that is known of it.

    Attributes:
        loaded: as it was read.
        problem: with the cameras and rigs that were asked for.
        edits: of its cameras; None: there are none.
        options: of the solve, images by id.
        output: path and format of OUTPUT.
        known: priors of positions and control points, if any.
        place: content of the georeference.json beside INPUT, if any.
        sliced: its refinement by processes that read a slice each; None: one process reads all.
        load_time: seconds.
    """

    loaded: Problem
    problem: Problem
    edits: CameraEdits | None
    options: SolveOptions
    output: dict[str, str]
    known: GcpPriors | GpsPriors | None
    place: dict[str, Any] | None
    sliced: SlicedRefinement | None
    load_time: float


def _checkpoints_given(arguments: argparse.Namespace) -> CheckpointOptions:
    """Return the files of a run that may be killed, and note where a run starts over."""
    given = options_given(arguments, CheckpointOptions)
    if given.resume is not None and not Path(given.resume).exists():
        complain(f"note: {shown(given.resume)} does not exist; the run starts with the input")
    return given


def run(arguments: argparse.Namespace) -> int:
    """Refine INPUT into OUTPUT."""
    refuse_flags_of_graphs(arguments)
    started = perf_counter()
    asked = Refinement.of(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        opened = _open(arguments, asked, progress)
        if arguments.check_gradients and _has_wrong_jacobians(arguments, opened, progress):
            return EXIT_NO_SOLUTION
        closed = _close_loops(asked.loops, opened, progress)
        solved = _solve(asked, opened, closed, progress)
        georeference = None if opened.known is None else opened.known.georeference(solved)
        begun = perf_counter()
        written, lost = _write(opened, solved, georeference, progress)
        save_time = perf_counter() - begun
        statistics_time = _measure(opened, solved, progress)
        if arguments.html is not None:
            _write_page(arguments, asked, opened, solved, georeference, progress)
    wall = WallTime(
        load=opened.load_time,
        build=solved.build_time_in_seconds,
        solve=solved.solve_time_in_seconds,
        save=save_time,
        statistics=statistics_time,
        total=perf_counter() - started,
    )
    told = (arguments.input, opened.loaded, solved, wall, written)
    report = refinement(*told, lost, asked.beside(), georeference, opened.edits, closed)
    publish(report, arguments.json)
    if solved.summary.is_solution_usable and not solved.summary.interrupted:
        return EXIT_DONE
    if arguments.json == "-":  # the report that people read was not printed
        complain(solved.outcome)
    return EXIT_NO_SOLUTION


def _open(arguments: argparse.Namespace, asked: Refinement, progress: Progress) -> Opened:
    """Read INPUT, change its cameras and rigs, and check that OUTPUT can be written."""
    source = arguments.input
    progress.stage(f"reading {shown(source)}")
    begun = perf_counter()
    beside = arguments.html or arguments.rig_config or arguments.check_gradients
    plain = asked.is_plain and not beside
    sliced = sliced_input(arguments, asked.options) if plain else None
    loaded = load(source, progress.text) if sliced is None else sliced.cameras
    load_time = perf_counter() - begun
    if loaded.num_observations == 0:
        raise InputError(f"{shown(source)}: expected observations to refine, found none")
    edits = cameras_edited(asked.lenses, loaded)
    problem = with_rigs(loaded if edits is None else edits.problem, arguments.rig_config)
    options = with_named_images(asked.options, arguments, problem)
    output = _checked_output(arguments, problem, options)
    for what, path in (
        ("control points", asked.georeference.gcp),
        ("positions", asked.georeference.gps),
    ):
        if path is not None:
            check_georeference(**output)
            progress.stage(f"reading {what}: {shown(path)}")
    known = priors_of(asked.georeference, problem)
    place = georeference_at(source)
    if place is not None:
        check_georeference(**output)
    return Opened(
        loaded=loaded,
        problem=problem,
        edits=edits,
        options=options,
        output=output,
        known=known,
        place=place,
        sliced=sliced,
        load_time=load_time,
    )


def _checked_output(
    arguments: argparse.Namespace, problem: Problem, options: SolveOptions
) -> dict[str, str]:
    """Return path and format of OUTPUT, which can be written and may be replaced."""
    source, target = arguments.input, arguments.output
    output = {"path": target, "format": output_format(problem, target, arguments.format, source)}
    fixed = options.fixed_camera_ids
    check_target(problem, **output, refined=options.refine, fixed_camera_ids=fixed)
    check_replaced(target, [source], arguments.overwrite, same_images(problem))
    return output


def _close_loops(given: LoopOptions, opened: Opened, progress: Progress) -> LoopClosing | None:
    if given.loops is not None:
        progress.stage(f"closing the loops of {shown(given.loops)}")
    return loops_closed(given, opened.problem)


def _solve(
    asked: Refinement, opened: Opened, closed: LoopClosing | None, progress: Progress
) -> Result:
    """Refine the problem under its priors, rules and loops, in rounds if these were asked for."""
    progress.stage("building the problem")
    flags = {**FLAGS, "priors": main_flag(asked.georeference)}
    known, checkpoints = opened.known, asked.checkpoints.asdict()
    with naming_flags(SolveOptions, RoundOptions, **flags):
        if opened.sliced is not None:
            return opened.sliced.solve(opened.options, progress.iteration, **checkpoints)
        plan = RunPlan(rounds=asked.rounds, **checkpoints)
        request = SolveRequest(
            problem=opened.problem if closed is None else closed.problem,
            options=opened.options,
            factors=() if closed is None else closed.factors,
            priors=() if known is None else known.priors,
            align=None if known is None else True,
            constraints=asked.constraints,
            part=PartRequest.of(asked.local.only_images, asked.local.rest),
        )
        return solve_rounds.run(request, plan, progress.iteration)


def _write(
    opened: Opened, solved: Result, georeference: Georeference | None, progress: Progress
) -> tuple[dict[str, str] | None, tuple[str, ...]]:
    """Write what is worth it; return where, and what the format does not keep."""
    if not (solved.summary.is_solution_usable or solved.summary.interrupted):
        return None, ()
    target = opened.output["path"]
    progress.stage(f"writing {shown(target)}")
    if opened.sliced is None:
        lost = save(solved.problem, **opened.output, progress=progress.text)
    else:
        lost = opened.sliced.save(Path(target))
    if georeference is not None:
        write_georeference(georeference, **opened.output)
    else:
        carry_georeference(opened.place, **opened.output, changed=STAYED)
    return opened.output, lost


def _measure(opened: Opened, solved: Result, progress: Progress) -> float:
    """Measure reprojection errors before and after; return the seconds that took."""
    progress.stage("measuring reprojection errors")
    begun = perf_counter()
    if opened.sliced is not None:
        opened.sliced.measure(solved)
    _ = solved.reprojection_error_before
    progress.share(0.5)
    solved.measure()
    return perf_counter() - begun


def _write_page(
    arguments: argparse.Namespace,
    asked: Refinement,
    opened: Opened,
    solved: Result,
    georeference: Georeference | None,
    progress: Progress,
) -> None:
    """Write the report page, whose figures most runs do without."""
    from bundle.reports.page.report_page import write_report

    progress.stage(f"writing {shown(arguments.html)}")
    write_report(
        solved,
        arguments.html,
        images=arguments.images,
        priors=() if opened.known is None else opened.known.priors,
        constraints=asked.constraints,
        georeference=georeference,
        name=str(arguments.input),
    )


def _has_wrong_jacobians(arguments: argparse.Namespace, opened: Opened, progress: Progress) -> bool:
    """Check the Jacobians; if any is wrong, report that in place of the solve."""
    from bundle.checking import gradient_report, jacobians  # for --check-gradients only
    from bundle.reports.terminal.check import checked

    progress.stage("checking the Jacobians")
    begun, options = perf_counter(), opened.options
    report = jacobians.check_jacobians(
        opened.problem, cheirality=options.cheirality, num_threads=options.num_threads
    )
    if report.verdict != "wrong":
        if not report.ok:
            complain(f"note: {gradient_report.outcome(report)} `bundle check` shows where.")
        return False
    if arguments.json == "-":
        complain(gradient_report.outcome(report))
    settings = {"check_gradients": True, **options.asdict()}
    took = perf_counter() - begun
    publish(checked(arguments.input, opened.problem, report, settings, took), arguments.json)
    return True
