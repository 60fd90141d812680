"""`bundle refine`."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from bundle.cli.constraint_flags import add_constraint_flags, as_options, constraints_given
from bundle.cli.error_lines import EXIT_DONE, EXIT_NO_SOLUTION
from bundle.cli.gps_flags import NAMED, add_gps_flags, check_gps_flags, main_flag
from bundle.cli.lens_flags import add_lens_flags, cameras_edited
from bundle.cli.loop_flags import add_loop_flags, check_loop_flags, loops_closed
from bundle.cli.many_processes import note_alone
from bundle.cli.option_flags import (
    add_options,
    naming_flags,
    options_given,
    with_named_images,
)
from bundle.cli.parser import add_input, add_output, add_rig_config, with_rigs
from bundle.cli.path_checks import PathArgument, page_path
from bundle.cli.pose_graph_flags import add_pose_graph_flags, refuse_flags_of_graphs
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL, RESTS, RoundOptions
from bundle.io.recognition import is_pose_graph_file

if TYPE_CHECKING:
    from bundle.model.problem import Problem

__all__ = ["HELP", "NAME", "add_arguments", "run"]

NAME = "refine"
HELP = (
    "bundle adjustment: poses, points and intrinsics that explain the observations best; of a pose "
    "graph (.g2o) the poses that explain its edges best"
)

STAYED = "Refined again without positions, from where they had placed it."

# Arguments of bundle.solve_rounds that are no options.
ARGUMENTS = {
    "only_images": "--only-images",
    "rest": "--rest",
    "checkpoint": "--checkpoint",
    "checkpoint_interval": "--checkpoint-interval",
    "resume": "--resume",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of this command."""
    parser.usage = "bundle refine INPUT -o OUTPUT [options]"
    add_input(parser)
    add_output(parser, "-o", "--output", required=True)
    add_rig_config(parser)
    add_options(parser, SolveOptions, "options of the solve")
    add_pose_graph_flags(parser)
    add_options(parser, RoundOptions, "rounds of adjusting and filtering")
    add_constraint_flags(parser)
    add_gps_flags(parser)
    add_lens_flags(parser)
    parser.add_argument(
        "--only-images",
        metavar="IMAGES",
        help="refine only these images, the points that they see and their cameras, and leave all "
        "else as it is, bit for bit; other images that see these points take part, held (ids and "
        "names, such as 1,5-9,left/*.jpg; default: all images)",
    )
    parser.add_argument(
        "--rest",
        choices=RESTS,
        default=None,
        help="with --only-images, what all else does. fixed: other images that see these points "
        "are held. marginal: they and their cameras move too, under the exact marginal prior of "
        "everything that does not take part; only the named images, their points and cameras are "
        f"written (default: {RESTS[0]})",
    )
    add_loop_flags(parser)
    group = parser.add_argument_group("runs that may be killed")
    group.add_argument(
        "--checkpoint",
        metavar="FILE",
        type=PathArgument("checkpoint", replaces=("resume",)),
        help="write FILE after each round and every few iterations, for --resume (default: none)",
    )
    group.add_argument(
        "--checkpoint-interval",
        metavar="N",
        type=int,
        default=None,
        help="iterations from one checkpoint to the next within a round; the solver starts anew "
        f"from each, which takes a few more steps (default: {CHECKPOINT_INTERVAL})",
    )
    group.add_argument(
        "--resume",
        metavar="FILE",
        type=PathArgument("checkpoint", replaces=("checkpoint",)),
        help="go on from this checkpoint, with the same INPUT and options (--threads may differ), "
        "and go on writing it; from the start if there is no such file. With --deterministic the "
        "result is that of a run with --checkpoint that was not killed, bit for bit",
    )
    parser.add_argument(
        "--html",
        metavar="FILE",
        type=page_path(),
        help="also write a report page, as `bundle report` does, with residuals before and after; "
        "--images DIR has its photographs (default: none)",
    )
    parser.add_argument(
        "--check-gradients",
        action="store_true",
        help="first check the Jacobians on a sample, as `bundle check` does, and stop with its "
        "report if any is wrong, not where that is undecided (default: off)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Refine INPUT into OUTPUT."""
    if is_pose_graph_file(arguments.input):
        note_alone("refines the pose graph")
        from bundle.cli.pose_graph_commands import refine_graph

        return refine_graph(arguments)
    refuse_flags_of_graphs(arguments)
    started = perf_counter()
    from bundle.cli.carried_georeference import (
        carry_georeference,
        check_georeference,
        georeference_at,
        write_georeference,
    )
    from bundle.cli.gps_flags import priors_given
    from bundle.cli.output import check_replaced, publish, same_images
    from bundle.cli.progress import Progress
    from bundle.cli.sliced_input import sliced_input
    from bundle.cli.standard_streams import complain
    from bundle.errors import InputError, shown
    from bundle.io.open import check_target, load, output_format, save
    from bundle.reports.terminal.refine import refinement
    from bundle.reports.terminal.timing import WallTime
    from bundle.solving.rounds.solve_rounds import solve_rounds

    options = options_given(arguments, SolveOptions, names_follow=True)
    if arguments.rest is not None and arguments.only_images is None:
        raise InputError(f"--rest: expected with --only-images only, found {arguments.rest}")
    rounds = _rounds_given(arguments)
    check_gps_flags(arguments, options)
    check_loop_flags(arguments)
    constraints = constraints_given(arguments)
    source, target = arguments.input, arguments.output
    checkpoints = _checkpoints_given(arguments)
    with Progress(quiet=arguments.quiet) as progress:
        progress.stage(f"reading {shown(source)}")
        begun = perf_counter()
        sliced = sliced_input(arguments, options)
        loaded = load(source, progress.text) if sliced is None else sliced.cameras
        load_time = perf_counter() - begun
        if loaded.num_observations == 0:
            raise InputError(f"{shown(source)}: expected observations to refine, found none")
        edits = cameras_edited(arguments, loaded)
        problem = loaded if edits is None else edits.problem
        problem = with_rigs(problem, arguments.rig_config)
        options = with_named_images(options, arguments, problem)
        output = {
            "path": target,
            "format": output_format(problem, target, arguments.format, source),
        }
        check_target(
            problem, **output, refined=options.refine, fixed_camera_ids=options.fixed_camera_ids
        )
        check_replaced(target, [source], arguments.overwrite, same_images(problem))
        for what, path in (("control points", arguments.gcp), ("positions", arguments.gps)):
            if path is not None:
                check_georeference(**output)
                progress.stage(f"reading {what}: {shown(path)}")
        known = priors_given(arguments, problem)
        place = georeference_at(source)
        if place is not None:
            check_georeference(**output)
        if arguments.check_gradients:
            progress.stage("checking the Jacobians")
            wrong = _wrong_jacobians(arguments, problem, options)
            if wrong:
                return EXIT_NO_SOLUTION
        closed = None
        if arguments.loops is not None:
            progress.stage(f"closing the loops of {shown(arguments.loops)}")
            closed = loops_closed(arguments, problem)
            problem = closed.problem
        progress.stage("building the problem")
        flags = {**ARGUMENTS, **NAMED, "priors": main_flag(arguments)}
        with naming_flags(SolveOptions, RoundOptions, **flags):
            if sliced is not None:
                solved = sliced.solve(options, progress.iteration, **checkpoints)
            else:
                solved = solve_rounds(
                    problem,
                    options,
                    **rounds.asdict(),
                    only_images=arguments.only_images,
                    rest=arguments.rest or RESTS[0],
                    factors=() if closed is None else closed.factors,
                    priors=() if known is None else known.priors,
                    align=None if known is None else True,
                    constraints=constraints,
                    **checkpoints,
                    progress=progress.iteration,
                )
        georeference = None if known is None else known.georeference(solved)
        begun = perf_counter()
        lost: tuple[str, ...] = ()
        saved = solved.summary.is_solution_usable or solved.summary.interrupted
        if saved:
            progress.stage(f"writing {shown(target)}")
            if sliced is None:
                lost = save(solved.problem, **output, progress=progress.text)
            else:
                lost = sliced.save(Path(target))
            if georeference is not None:
                write_georeference(georeference, **output)
            else:
                carry_georeference(place, **output, changed=STAYED)
        save_time = perf_counter() - begun
        progress.stage("measuring reprojection errors")
        begun = perf_counter()
        if sliced is not None:
            sliced.measure(solved)
        _ = solved.reprojection_error_before
        progress.share(0.5)
        solved.measure()
        statistics_time = perf_counter() - begun
        if arguments.html is not None:
            from bundle.reports.page.report_page import write_report

            progress.stage(f"writing {shown(arguments.html)}")
            write_report(
                solved,
                arguments.html,
                images=arguments.images,
                priors=() if known is None else known.priors,
                constraints=constraints,
                georeference=georeference,
                name=str(source),
            )
    wall = WallTime(
        load=load_time,
        build=solved.build_time_in_seconds,
        solve=solved.solve_time_in_seconds,
        save=save_time,
        statistics=statistics_time,
        total=perf_counter() - started,
    )
    written = output if saved else None
    more = rounds.asdict() if rounds.num_rounds else {}
    if arguments.only_images is not None:
        more |= {"only_images": arguments.only_images, "rest": arguments.rest or RESTS[0]}
    more |= checkpoints | as_options(arguments)
    report = refinement(
        source, loaded, solved, wall, written, lost, more, georeference, edits, closed
    )
    publish(report, arguments.json)
    if solved.summary.is_solution_usable and not solved.summary.interrupted:
        return EXIT_DONE
    if arguments.json == "-":  # the report that people read was not printed
        complain(solved.outcome)
    return EXIT_NO_SOLUTION


def _rounds_given(arguments: argparse.Namespace) -> RoundOptions:
    """Return the rounds that were asked for.

    Raises:
        InputError: a value is out of range, or there are limits but no rounds.
    """
    from bundle.errors import InputError

    rounds = options_given(arguments, RoundOptions)
    for field in dataclasses.fields(RoundOptions):
        given = getattr(arguments, field.name) is not None and field.name != "num_rounds"
        if given and rounds.num_rounds == 0:
            raise InputError(f"{field.metadata['flag']}: expected with --rounds only")
    return rounds


def _checkpoints_given(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what was said about checkpoints, and say where a run starts over.

    Raises:
        InputError: there is an interval but no checkpoint.
    """
    from bundle.cli.standard_streams import complain
    from bundle.errors import InputError, shown

    files = {name: getattr(arguments, name) for name in ("checkpoint", "resume")}
    if arguments.checkpoint_interval is None:
        given = {}
    elif not any(files.values()):
        raise InputError("--checkpoint-interval: expected with --checkpoint or --resume only")
    else:
        given = {"checkpoint_interval": arguments.checkpoint_interval}
    if arguments.resume is not None and not Path(arguments.resume).exists():
        complain(f"note: {shown(arguments.resume)} does not exist; the run starts with the input")
    return {name: value for name, value in files.items() if value is not None} | given


def _wrong_jacobians(
    arguments: argparse.Namespace, problem: Problem, options: SolveOptions
) -> bool:
    """Check the Jacobians; if any is wrong, report that in place of the solve."""
    from bundle.checking.gradient_report import outcome
    from bundle.checking.jacobians import check_jacobians
    from bundle.cli.output import publish
    from bundle.cli.standard_streams import complain
    from bundle.reports.terminal.check import checked

    begun = perf_counter()
    report = check_jacobians(
        problem, cheirality=options.cheirality, num_threads=options.num_threads
    )
    if report.verdict != "wrong":
        if not report.ok:
            complain(f"note: {outcome(report)} `bundle check` shows where.")
        return False
    if arguments.json == "-":
        complain(outcome(report))
    settings = {"check_gradients": True, **options.asdict()}
    took = perf_counter() - begun
    publish(checked(arguments.input, problem, report, settings, took), arguments.json)
    return True
