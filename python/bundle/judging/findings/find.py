"""All findings about a model, the most important first."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bundle.analysis.diagnosis.track_table import TrackTable, weak_joint
from bundle.errors import InputError
from bundle.interface.finding import Finding
from bundle.interface.options import SolveOptions
from bundle.judging.findings.contradicted_constants import HELD, contradicted_constants
from bundle.judging.findings.contradicted_rules import contradicted_holds, contradicted_priors
from bundle.judging.findings.duplicates import duplicate_points
from bundle.judging.findings.focal_lengths import (
    PRIOR,
    focal_drift,
    focal_lengths,
    is_near,
    shared_lens,
    undetermined_intrinsics,
)
from bundle.judging.findings.images import ImageFits, image_fits, image_residuals, motion, variation
from bundle.judging.findings.larger_lens import absorbed_lens
from bundle.judging.findings.lens_terms import LensField, fields_of_lenses, lens_model
from bundle.judging.findings.measured import Measured
from bundle.judging.findings.minimum import not_refined, shifted_pixels, under_its_loss
from bundle.judging.findings.next_command import NextCommand
from bundle.judging.findings.outliers import outliers
from bundle.judging.findings.positions import (
    is_tense,
    measured_positions,
    position_offset,
    scale_drift,
)
from bundle.judging.findings.repaired import is_affordable, repaired
from bundle.judging.findings.systematic import SystematicResiduals
from bundle.judging.findings.wrong_attitudes import wrong_attitudes
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem

IMPORTANCE = (
    *("shifted_pixels", "not_refined", "rules", "outliers", "lens_model"),
    *(row.kind for row in HELD),
    "weak_joint",
    *("undetermined_intrinsics", "motion"),
    *("gps_offset", "positions", "attitudes", "scale_drift", "focal_drift", "shared_lens"),
    *("image_residuals", "duplicate_points"),
)
"""Kinds of findings, the most important first."""
BENDING = ("lens_model", "motion", "shared_lens")
"""Faults that bend a model more if only a loss against outliers is added."""


# Numbers of a valid problem may be as large as a double: an overflow becomes infinite.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def find(
    problem: Problem,
    *,
    source: str = "INPUT",
    target: str = "OUTPUT",
    given: Sequence[str] = (),
    options: SolveOptions | None = None,
    **known: Any,
) -> tuple[Finding, ...]:
    """Return what a user should know about a model and do next.

    Measured and NextCommand explain the arguments; lens_sigmas are computed here if they are None
    and take milliseconds. Measured positions and attitudes are in the frame of the problem.
    """
    used = {problem.camera_models[camera] for camera in set(problem.image_camera.tolist())}
    if not problem.num_observations or not used <= camera_models().keys():
        return ()
    measured = Measured(
        whole=problem,
        command=NextCommand(source, target, given),
        options=SolveOptions() if options is None else options,
        **known,
    )
    given_findings = (one for one in _findings(measured) if one is not None)
    found = {one.kind: _allowed(measured, one) for one in given_findings}
    drift, loose = found.get("scale_drift"), found.get("undetermined_intrinsics")
    if drift is not None and loose is not None and drift.command and loose.command:
        # Positions that move the cameras far would move them along what is not determined.
        found["scale_drift"] = dataclasses.replace(drift, command=loose.command)
    repairs = [one.command for one in found.values() if one.kind in BENDING]
    repairs = [command for command in repairs if command.startswith("bundle refine")]
    if "outliers" in found and repairs:  # the last stage has the repairs of all before it
        found["outliers"] = dataclasses.replace(found["outliers"], command=repairs[-1])
    return tuple(found[kind] for kind in IMPORTANCE if kind in found)


def _allowed(measured: Measured, finding: Finding) -> Finding:
    """Return a finding, without its command if a rule of the run contradicts the command."""
    rules = list(measured.constraints)
    if not rules or not finding.command.startswith("bundle refine"):
        return finding
    from bundle.editing.camera_sharing import edit_cameras  # only with rules
    from bundle.solving.constraints.resolve import apply
    from bundle.solving.constraints.rule_list import parse_rule

    problem = measured.start or measured.whole
    added = measured.command.added(finding.command)
    flags = dict(added)
    shared = flags.get("--share-cameras")
    try:
        share = shared is not None and (shared == "all" or list(map(int, shared.split(","))))
        edits = edit_cameras(problem, flags.get("--camera-model"), share, keep_scale=True)
        rules += [parse_rule(text, "the advised rule") for flag, text in added if flag == "--set"]
        apply(rules, problem if edits is None else edits.problem, measured.options)
    except InputError as error:
        sentence = f"{finding.sentence} Rules of this run contradict the command for it: {error}."
        return dataclasses.replace(finding, sentence=sentence, command="")
    return finding


def _lens(measured: Measured, fits: ImageFits, fields: Sequence[LensField]) -> Finding | None:
    is_varied = variation(measured.scale, fits, fields)[2]
    has_hint = is_varied or any(field.significant for field in fields)
    return lens_model(measured, fields) or absorbed_lens(measured, has_hint=has_hint)


def _repairs(measured: Measured) -> tuple[tuple[str, str], bool]:
    """Return the larger lens and the rolling shutter that a model needs; "": none.

    And True if it moved, but a shutter would increase standard deviations too much.
    """
    _, fits, fields, moves = _fields(measured)
    if moves is not None:
        return ("", str(moves.evidence["shutter"])), not moves.evidence["shutter"]
    lens = _lens(measured, fits, fields)
    return ("" if lens is None else str(lens.evidence["larger_model"]), ""), False


def _num_outliers(model: Measured, given: Measured) -> int:
    """Return the number of outliers of a model under the loss of another."""
    found = outliers(dataclasses.replace(model, options=given.options))
    return 0 if found is None else int(found.evidence["num_outliers"])


def _fields(
    measured: Measured,
) -> tuple[SystematicResiduals, ImageFits, list[LensField], Finding | None]:
    """Return the systematic residuals, their fields by image and lens, and the motion found."""
    found = SystematicResiduals(measured)
    fits = image_fits(found, measured.scale)
    fields = fields_of_lenses(found, measured.scale)
    return found, fits, fields, motion(measured, found, fits, fields)


def _contradiction(measured: Measured, far: Finding | None) -> Finding | None:
    """Return the finding about what the run knows or holds at a wrong value, or None.

    A model without its rule has no other fault. A prior has sigmas, which tell it from outliers
    ``far``; free parameters absorb these, and must leave at most half of them.
    """
    for test in (contradicted_priors, contradicted_holds, contradicted_constants):
        wrong, free = test(measured)
        if wrong is None or (wrong.kind == "rules" and free is not None and any(_repairs(free)[0])):
            continue
        if far is None or test is contradicted_priors:
            return wrong
        if free is not None and 2 * _num_outliers(free, measured) <= far.evidence["num_outliers"]:
            return wrong
    return None


def _findings(measured: Measured) -> Iterator[Finding | None]:
    joint = weak_joint(measured.whole, TrackTable(measured.whole))
    turned, offset = wrong_attitudes(measured), position_offset(measured)
    yield from (joint, duplicate_points(measured), turned, offset)
    start = shifted_pixels(measured) or not_refined(measured)
    if start is not None:
        yield start
        return  # other tests need a minimum
    far = outliers(measured)
    if far is not None and (under := under_its_loss(measured)) is not measured:
        measured, far = under, outliers(under)
    wrong = _contradiction(measured, far)
    if wrong is not None:
        yield wrong
        return  # what is held at a wrong value bends the model
    is_tensed = offset is None and is_tense(measured)  # an offset bends the model
    is_bent = is_tensed or turned is not None
    can_repair = is_affordable(measured)
    free = held = None
    if can_repair and (far is not None or is_bent):
        free = repaired(measured, is_bent=is_bent)
        far = outliers(measured, free)
    if free is not None and is_bent and far is not None:
        # Least squares spreads outliers over their neighbours: both models have a robust loss.
        held = repaired(measured, with_priors=True)
        if 2 * _num_outliers(free, measured) < _num_outliers(held or measured, measured):
            far = None  # positions that bend the model have made most of them
    drift = places = None
    if is_tensed:
        straight = free or measured
        repairs, is_moving = _repairs(straight)
        if any(repairs) and can_repair:
            straight = repaired(straight, *repairs) or straight
        placed = measured
        if far is not None:
            placed = (held or measured).of_command(measured.command.with_flags_of(far.command))
        if any(repairs) and can_repair:
            placed = repaired(placed, *repairs, with_priors=True) or placed
        is_open = can_repair and free is None
        drift = scale_drift(placed, straight.whole)
        if drift is None:
            places = measured_positions(placed, is_open=is_open, is_moving=is_moving)
    if far is not None and places is not None and places.command:
        far = dataclasses.replace(far, command=places.command)  # one without the other bends
    yield from (far, drift, places)
    if free is not None:
        command = measured.command
        if far is not None:
            command = command.with_flags_of(far.command)
        for one in (turned, drift, places):  # a bend is repaired beside what bends
            if one is not None and one.command:
                command = command.with_flags_of(one.command)
        measured = free.of_command(command)
    elif any(one is not None for one in (far, turned, drift, places)):
        return
    given = measured
    found, fits, fields, moves = _fields(measured)
    shutter = "" if moves is None else moves.evidence["shutter"]
    rolling = repaired(measured, shutter=shutter) if shutter and can_repair else None
    if moves is not None and rolling is not None:  # motion hides the field of a lens
        groups = [group for group in focal_lengths(rolling) if is_near(rolling, group)]
        loose = undetermined_intrinsics(rolling, groups, PRIOR)
        if loose is not None:  # the shutter and what determines its focal lengths
            moves = dataclasses.replace(moves, command=loose.command)
            rolling = rolling.of_command(rolling.command.with_flags_of(loose.command))
        yield moves
        measured = rolling
        found, fits, fields, _ = _fields(measured)
    lens = None if moves is not None and rolling is None else _lens(measured, fits, fields)
    yield lens
    if lens is not None:
        larger = repaired(measured, lens.evidence["larger_model"]) if can_repair else None
        if larger is None:
            return
        measured = larger
        found, fits, _, moved = _fields(measured)
        moves = moves or moved
    if rolling is None:
        yield moves
    near = {"is_jointed": joint is not None}
    yield image_residuals(measured, found, fits, is_general=moves is not None, **near)
    # What only a shutter leaves open, the command against motion determines.
    still = measured if rolling is None else given.of_command(measured.command)
    yield undetermined_intrinsics(still, list(focal_lengths(still)))
    groups = list(focal_lengths(measured))
    yield focal_drift(measured, groups, **near)
    shared = shared_lens(measured, groups, **near)
    if shared is not None and drift is not None:
        # A lens per image hides the drift; a shared lens pulls the images from the positions.
        shared = dataclasses.replace(
            shared, sentence=f"{shared.sentence} First decide about the drift.", command=""
        )
    yield shared
