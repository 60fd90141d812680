"""Command line that refines an input as a candidate does."""

from __future__ import annotations

import shlex

from bundle.editing.camera_sharing import split_cameras
from bundle.interface.options import SolveOptions
from bundle.judging.validation.candidates import Candidate, groups_of, tying_rules
from bundle.model.problem import Problem
from bundle.planning.comparison.recommendation import command_line


def refine_command(
    problem: Problem,
    candidate: Candidate,
    options: SolveOptions,
    source: str = "INPUT",
    output: str = "OUTPUT",
) -> str:
    """Return the `bundle refine` command of a candidate.

    Args:
        problem: the input.
        candidate: the candidate.
        options: options of its solve, as the user gave them.
        source: path of the input.
        output: path of the output.
    """
    options = options.replace(loss=candidate.loss, refine=candidate.refine)
    words = [command_line(options, source, output)]
    used = {problem.camera_models[camera] for camera in set(problem.image_camera.tolist())}
    if candidate.camera_model and used != {candidate.camera_model}:
        words.append(f"--camera-model {candidate.camera_model}")
    own, wanted = groups_of(problem, "input"), groups_of(problem, candidate.share)
    if own.tobytes() != wanted.tobytes() or candidate.share == "focal":
        words.append(_sharing(candidate.share))
    if problem.format == "bal" and candidate.camera_model not in ("", "RADIAL"):
        words.append("--format colmap")  # BAL has no other model
    if candidate.share == "focal":
        rules = tying_rules(split_cameras(problem), candidate)
        words += [f"--set {shlex.quote(rule)}" for rule in rules]
    return " ".join(words)


def _sharing(share: str) -> str:
    """Return the flag that gives the cameras of a sharing."""
    if share in ("each", "focal"):
        return "--split-cameras"
    return f"--share-cameras {share}"
