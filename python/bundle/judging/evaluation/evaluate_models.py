"""Comparison of a model or a trajectory with a reference: truth, or another model."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from bundle.base.paths import is_path
from bundle.base.words import few, plural
from bundle.errors import InputError, shown
from bundle.georeference.control_point import GroundControlPoint
from bundle.georeference.pose_alignment import align_centers, moved_poses
from bundle.interface.finding import Finding
from bundle.interface.judging_options import (
    DIRECTIONS,
    INPUT_FORMATS,
    POSE_FORMATS,
    REFERENCE_FORMATS,
    EvaluateOptions,
)
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.io.g2o_files import load_g2o
from bundle.io.pose_files import load_poses, pose_format
from bundle.io.recognition import is_pose_graph_file
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.judging.evaluation.association import Association, associate
from bundle.judging.evaluation.check_points import CheckPointEvaluation, check_points_of
from bundle.judging.evaluation.evaluation_result import Evaluation, RelativeErrors
from bundle.judging.evaluation.lens_difference import lens_differences
from bundle.judging.evaluation.movement_in_sigmas import SigmaMovement, movement_in_sigmas
from bundle.judging.evaluation.pair_errors import MOST_IMAGES as MOST_IN_PAIRS
from bundle.judging.evaluation.pair_errors import pair_errors, point_difference, shared_points
from bundle.judging.evaluation.verdict_word import Compared, findings_of, headline_of, word_of
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.pose_table import ErrorStatistics, PoseTable, absolute_errors, relative_errors
from bundle.model.problem import Problem

MOST_IMAGES = 300  # number of images up to which sigmas "auto" computes the covariance of A

METRIC = ("tum", "euroc", "kitti")  # formats of trajectories, whose length unit is the metre

Compare: TypeAlias = "Source | PoseTable | PoseGraph | Trajectory"
"""A reconstruction in any form, a pose graph, a trajectory, other poses, or a path of these."""


@takes_options(EvaluateOptions)
def evaluate(
    a: Compare,
    b: Compare | Sequence[GroundControlPoint],
    options: EvaluateOptions | None = None,
    **changes: Any,
) -> Evaluation | CheckPointEvaluation:
    """Compare a model or a trajectory with a reference.

    The reference is the truth, a measured trajectory, or another model. Errors are in the frame and
    the length unit of the reference, after the alignment of the shared centres. Two models are also
    compared by their lenses, by the points of common tracks, and in sigmas of A's covariance.

    Args:
        a: a Problem, a PoseGraph, a PoseTable, a Trajectory, a pycolmap.Reconstruction, or a path:
            of a COLMAP model, a BAL file, a g2o file, or other poses (TUM, EuRoC, KITTI, a list).
        b: the reference, in the same forms; or check points: a path as for ``bundle.align``, or
            ground control points.
        options: options; None: the defaults.
        **changes: options by name.

    Raises:
        InputError: an input has a wrong format, fewer than three poses are shared, or their centres
            lie on one line.
        OSError: a path cannot be read.

    Example:
        >>> found = bundle.evaluate("refined", "truth.tum", align="similarity")
        >>> found.position.rmse, found.rotation.rmse, found.auc["5"]
    """
    chosen = EvaluateOptions.of(options, changes, "evaluate")
    formats = {
        name: None if (given := getattr(chosen, name)) is None else choice(name, given, known)
        for name, known in (("format", REFERENCE_FORMATS), ("input_format", INPUT_FORMATS))
    }
    chosen = chosen.replace(**formats)
    model = open_input(a, "a", chosen.input_format, chosen.input_pose_direction)
    points = check_points_of(b, chosen.format, model)
    if points is not None and isinstance(model, Problem):
        for name in chosen.changed().keys() - {"format", "input_format", "align"}:
            raise InputError(f"{name}: expected no value with check points, where it has no effect")
        return CheckPointEvaluation.of(model, points, a, chosen.align)
    other = open_input(b, "b", chosen.format, chosen.pose_direction)
    words = [_word(a, "A"), _word(b, "B")]
    if chosen.loss != "trivial" and not (isinstance(model, Problem) and isinstance(other, Problem)):
        raise InputError("loss: expected two models, found poses, which have no covariance")
    return _evaluate(model, other, chosen, words)


def open_input(
    given: Any, name: str, format: str | None = None, direction: str = DIRECTIONS[0]
) -> Problem | PoseTable:
    """Return a model or a table of poses from any form of input.

    ``format``: format of a path; None: by its content.
    """
    if isinstance(given, PoseTable):
        return given
    if is_path(given) and format is None and is_pose_graph_file(given):
        given = load_g2o(given)
    if isinstance(given, PoseGraph):
        return PoseTable.of_graph(given)
    if isinstance(given, Trajectory):
        return PoseTable(given.states[:, :7], (), given.timestamps_ns, "memory")
    if is_path(given):
        path = Path(os.fspath(given))
        found = format if format in POSE_FORMATS else None
        if format is None and path.is_file():
            found = pose_format(path)
        if found is not None:
            return load_poses(given, found, direction)
        is_text_of_poses = path.suffix.lower() in (".tum", ".kitti", ".poses", ".csv")
        if path.is_file() and format is None and is_text_of_poses:  # with a wrong first line
            return load_poses(given, None, direction)
    problem = as_problem(given, name)
    if format in ("colmap", "bal") and problem.format != format and is_path(given):
        raise InputError(f"{shown(given)}: expected {format}, found {problem.format}")
    return problem


def _word(given: Any, otherwise: str) -> str:
    return shlex.quote(shown(given)) if is_path(given) else otherwise


def _evaluate(
    a: Problem | PoseTable, b: Problem | PoseTable, options: EvaluateOptions, words: list[str]
) -> Evaluation:
    tables = [PoseTable.of_problem(one) if isinstance(one, Problem) else one for one in (a, b)]
    pairs = associate(tables[0], tables[1], options.max_time_difference)
    given, reference = tables[0].poses[pairs.rows_a], tables[1].poses[pairs.rows_b]
    similarity = align_centers(given[:, 4:], reference[:, 4:], options.align)
    moved = moved_poses(given, similarity)
    position, rotation = absolute_errors(moved, reference)
    compared = Compared(
        given=given,
        moved=moved,
        reference=reference,
        alignment=options.align,
        similarity=similarity,
        position=position,
        rotation=rotation,
        association=pairs,
        directions=_directions(tables, options, words),
    )
    steps = [
        ErrorStatistics.of(errors) for errors in relative_errors(moved, reference, options.delta)
    ]
    word = word_of(compared)
    common: dict[str, Any] = {"lenses": (), "points": None, "movement": None}
    notes: list[str] = []
    if isinstance(a, Problem) and isinstance(b, Problem):
        if word == "identical" and options.sigmas == "auto":
            options = options.replace(sigmas="off")
        rows = pairs.rows_a, pairs.rows_b
        points = shared_points(a, b, *rows)
        movement, notes = _movement(a, b, pairs, options)
        common = {
            "lenses": lens_differences(a, b, *rows),
            "points": point_difference(a, b, points, compared.similarity) if len(points) else None,
            "movement": movement,
        }
    elif options.sigmas == "on":
        raise InputError("sigmas: expected two models, found poses")
    findings = [*findings_of(compared), *_missing(pairs)]
    result = {
        "verdict": word,
        "findings": tuple(sorted(findings, key=lambda one: not one.is_problem)),
        "association": pairs,
        "inputs": (_described(a), _described(b)),
        "unit": "m" if tables[1].format in METRIC else "units",
        "alignment": options.align,
        "similarity": similarity,
        "size": compared.size,
        "position": ErrorStatistics.of(position),
        "rotation": ErrorStatistics.of(rotation),
        "position_errors": position,
        "rotation_errors": rotation,
        "relative": RelativeErrors(options.delta, *steps),
        "pairs": pair_errors(given, reference, 0 if pairs.by == "time" else len(pairs.only_b)),
        "auc_definition": options.auc,
        "notes": (*_notes(pairs), *notes),
        "estimate": moved[:, 4:],
        "reference": reference[:, 4:],
        **common,
    }
    return Evaluation(headline=headline_of(result), **result)


def _described(one: Problem | PoseTable) -> dict[str, Any]:
    if isinstance(one, PoseTable):
        return {"format": one.format, "num_poses": len(one)}
    counts = ("num_cameras", "num_images", "num_points", "num_observations")
    return {"format": one.format, **{name: getattr(one, name) for name in counts}}


def _directions(
    tables: Sequence[PoseTable], options: EvaluateOptions, words: list[str]
) -> dict[str, str]:
    """Return commands that read A or B as inverse poses; "" if the format fixes the direction."""
    given = (options.input_pose_direction, options.pose_direction)
    flags = ("--input-pose-direction", "--pose-direction")
    commands = {}
    for name, table, way, flag in zip("AB", tables, given, flags, strict=True):
        if table.format not in (*POSE_FORMATS, "memory"):
            continue
        other = DIRECTIONS[way == DIRECTIONS[0]].replace("_", "-")
        command = f"bundle evaluate {words[0]} --reference {words[1]} {flag} {other}"
        commands[name] = command if table.format == "poses" else ""
    return commands


def _movement(
    a: Problem, b: Problem, pairs: Association, options: EvaluateOptions
) -> tuple[SigmaMovement | None, list[str]]:
    if options.sigmas == "off" or not a.num_observations:
        return None, []
    if options.sigmas == "auto" and a.num_images > MOST_IMAGES:
        return None, [f"No sigmas: A has more than {MOST_IMAGES} images (--sigmas on)."]
    try:
        solved = SolveOptions(loss=options.loss, loss_scale=options.loss_scale)
        found = movement_in_sigmas(a, b, pairs.rows_a, pairs.rows_b, solved)
    except InputError as error:
        if options.sigmas == "on":
            raise
        return None, [f"No sigmas: {error}."]
    return found, list(found.notes)


def _missing(pairs: Association) -> list[Finding]:
    count = len(pairs.only_b)
    if not count or pairs.by == "time":
        return []
    return [
        Finding(
            kind="missing_images",
            sentence=f"A lacks {plural(count, 'image')} of B: {few(pairs.only_b)}.",
            evidence={"num_images": count, "num_shared": len(pairs)},
        )
    ]


def _notes(pairs: Association) -> Iterable[str]:
    if pairs.by not in ("name", "time"):
        yield f"Poses are associated {pairs.sentence}."
    if len(pairs) > MOST_IN_PAIRS:
        yield f"Pairs are those of {MOST_IN_PAIRS} evenly spaced poses of {len(pairs)}."
    if pairs.only_a and pairs.by != "time":
        yield f"B lacks {plural(len(pairs.only_a), 'image')} of A (without influence here)."
