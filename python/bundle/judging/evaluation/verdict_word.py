"""Verdict on a comparison: one word, headline, and causes of large differences (docs/evaluate.md).

The word depends on the position error relative to the size of B (root mean square distance of its
shared centres from their mean) and on the rotation error, both as root mean squares over images.
Causes are tried one by one; A or B are read as inverse poses, where half of the position error
suffices, because rotations decide. Other axes are one rotation Q of the camera, R_B^T R_A = Q for
all images: the eigenvector of sum q q^T of the quaternions of the errors (Markley et al. 2007).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import few, noun, number, plural
from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers, angle_about_line, moved_poses
from bundle.georeference.similarity import Similarity, agreeing
from bundle.interface.finding import Finding
from bundle.judging.evaluation.association import Association
from bundle.judging.evaluation.lens_difference import LensDifference
from bundle.judging.evaluation.movement_in_sigmas import SigmaMovement
from bundle.model.pose_table import ErrorStatistics, absolute_errors, angles_of
from bundle.model.rigid_motions import inverse_poses, quaternion_inverse, quaternion_multiply

IDENTICAL = (1e-9, 1e-12, 1e-6)
AGREES, CLOSE, CONTRADICTS = (0.01, 1.0), (0.05, 5.0), (0.5, 45.0)
"""Limits of the position error relative to the size, and of the rotation error in degrees."""

EXPLAINED = 0.2  # remaining share of an error below which its cause is a finding
WORST_ANGLE = np.radians(1.0)
"""Uncertainty of the rotation about the line of the centres above which it is a finding."""
SURE = 5.0  # sigmas of the rotation of the alignment beyond which a rotation has another cause
THIN = 0.2  # ratio of width to length below which centres are near a line
MOST_NAMES = 3

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Compared:
    """Poses of the pairs, and their errors."""

    given: Array  # (n, 7) poses world_from_camera of A in A's frame
    moved: Array  # (n, 7) aligned poses of A
    reference: Array  # (n, 7) poses of B
    alignment: str  # alignment of A to B
    similarity: Similarity  # the map from A to B
    position: Array  # (n,) position errors
    rotation: Array  # (n,) rotation errors in degrees
    association: Association  # names of the pairs
    directions: Mapping[str, str]  # command that reads A or B as inverse poses, by "A" and "B"

    @property
    def size(self) -> float:
        """Root mean square distance of B's centres from their mean."""
        return size_of(self.reference)

    def rms(self) -> tuple[float, float]:
        """Return the root mean squares of position and rotation errors."""
        return ErrorStatistics.of(self.position).rmse, ErrorStatistics.of(self.rotation).rmse


def size_of(poses: Array) -> float:
    """Return the root mean square distance of the centres of poses from their mean."""
    centers = poses[:, 4:]
    return ErrorStatistics.of(np.linalg.norm(centers - centers.mean(axis=0), axis=1)).rmse


def word_of(given: Compared) -> str:
    """Return the verdict in one word."""
    position, rotation = given.rms()
    relative = position / given.size if given.size > 0 else np.inf
    largest = float(np.abs(given.reference[:, 4:]).max())
    rounding = IDENTICAL[0] * given.size + IDENTICAL[1] * largest
    if given.position.max() <= rounding and given.rotation.max() <= IDENTICAL[2]:
        return "identical"
    for word, (length, angle) in (("agrees", AGREES), ("close", CLOSE)):
        if relative <= length and rotation <= angle:
            return word
    is_far = relative > CONTRADICTS[0] or rotation > CONTRADICTS[1]
    return "contradicts" if is_far else "differs"


def findings_of(given: Compared) -> list[Finding]:
    """Return the causes of large differences."""
    if word_of(given) == "identical" or given.size == 0:
        return []
    direction = _direction(given)
    if direction is not None:
        return [direction]
    tests = (_mirrored, _outlier_images, _axes)
    found = [finding for test in tests if (finding := test(given)) is not None]
    if not found and (line := _near_line(given)) is not None:  # other causes leave residuals, too
        found.append(line)
    return found


def _outlier_images(given: Compared) -> Finding | None:
    count = len(given.position)
    source, target = given.given[:, 4:], given.reference[:, 4:]
    if count < 5 or given.alignment not in ("similarity", "rigid"):
        return None
    sigmas = np.full((count, 3), 1e-9 * given.size)
    chosen = agreeing(source, target, sigmas)
    if chosen.all():
        return None
    try:
        similarity = align_centers(source[chosen], target[chosen], given.alignment)
    except InputError:
        return None
    errors = np.linalg.norm(similarity.apply(source) - target, axis=1)
    usual = ErrorStatistics.of(errors[chosen]).rmse
    far = np.flatnonzero(errors > max(5 * usual, AGREES[0] * given.size))
    if not len(far) or usual > EXPLAINED * given.rms()[0]:
        return None
    far = far[np.argsort(-errors[far], kind="stable")]
    names = few((given.association.names[row] for row in far), MOST_NAMES)
    rest = ErrorStatistics.of(np.delete(errors, far)).rmse
    return Finding(
        kind="outlier_images",
        sentence=f"{plural(len(far), _thing(given.association))} "
        f"{noun(len(far), 'is', 'are')} far off ({names}; "
        f"up to {number(float(errors.max()))}). The other {count - len(far)} agree within "
        f"{number(rest)} rms if they alone determine the alignment.",
        evidence={
            "images": [given.association.names[row] for row in far],
            "max": float(errors.max()),
            "rmse_of_others": rest,
        },
    )


def _errors_of(given: Compared, poses: Array, reference: Array) -> tuple[float, float]:
    """Return errors of other poses relative to the size and in degrees; inf: no alignment."""
    try:
        similarity = align_centers(poses[:, 4:], reference[:, 4:], given.alignment)
    except InputError:
        return np.inf, np.inf
    position, rotation = absolute_errors(moved_poses(poses, similarity), reference)
    size = size_of(reference)
    return ErrorStatistics.of(position).rmse / size, ErrorStatistics.of(rotation).rmse


def _mirrored(given: Compared) -> Finding | None:
    mirrored = given.given * np.array([1.0, 1, 1, 1, 1, 1, -1])
    relative, before = _errors_of(given, mirrored, given.reference)[0], given.rms()[0] / given.size
    if relative > EXPLAINED * before or before <= CLOSE[0]:
        return None
    return Finding(
        kind="mirrored",
        sentence="A is a mirror image of B: with one coordinate negated, positions differ by "
        f"{number(100 * relative)} % of the size of B. A handedness or an axis differs.",
        evidence={"relative_rmse": relative},
        is_problem=True,
    )


def _direction(given: Compared) -> Finding | None:
    found = {}
    for name, command in given.directions.items():
        poses, reference = given.given, given.reference
        if name == "A":
            after = _errors_of(given, inverse_poses(poses), reference)
        else:
            after = _errors_of(given, poses, inverse_poses(reference))
        before = given.rms()[0] / given.size, given.rms()[1]
        if after[0] <= before[0] / 2 and after[1] <= EXPLAINED * before[1]:
            found[name] = command, after
    if not found:
        return None
    names = " or ".join(found)
    command, (position, rotation) = next(iter(found.values()))
    return Finding(
        kind="direction",
        sentence=f"The poses of {names} have the opposite direction: read as inverses, they differ "
        f"by {number(100 * position)} % of the size of B and {number(rotation)} degrees.",
        command=command,
        evidence={"inputs": list(found), "relative_rmse": position, "rotation_rmse": rotation},
        is_problem=True,
    )


def _axes(given: Compared) -> Finding | None:
    errors = quaternion_multiply(quaternion_inverse(given.reference[:, :4]), given.moved[:, :4])
    common = np.linalg.eigh(errors.T @ errors)[1][:, -1]
    rest = quaternion_multiply(errors, quaternion_inverse(np.tile(common, (len(errors), 1))))
    before, after = given.rms()[1], ErrorStatistics.of(angles_of(rest)).rmse
    if before <= CLOSE[1] or after > EXPLAINED * before:
        return None
    angle = float(angles_of(common[None])[0])
    # Cameras with the same viewing direction get the same rotation error if noisy centres rotate
    # the alignment.
    noise, _ = angle_about_line(given.reference[:, 4:], given.position)
    if given.rms()[0] > CLOSE[0] * given.size or angle <= SURE * np.degrees(noise):
        return None
    why = (
        "The axes of the cameras differ (camera against IMU, or OpenCV against OpenGL), or a path "
        "in a plane is mirrored."
    )
    return Finding(
        kind="axes",
        sentence=f"Rotation errors are one rotation of {number(angle)} degrees for all images; "
        f"{number(after)} degrees rms remain without it. {why}",
        evidence={"rotation_degrees": angle, "rmse_without": after, "quaternion": common.tolist()},
    )


def _near_line(given: Compared) -> Finding | None:
    if given.alignment not in ("similarity", "rigid"):
        return None
    angle, ratio = angle_about_line(given.reference[:, 4:], given.position)
    if angle <= WORST_ANGLE or ratio > THIN or given.rms()[0] > THIN * given.size:
        return None
    degrees = min(float(np.degrees(angle)), 180.0)
    return Finding(
        kind="near_line",
        sentence="The shared centres lie nearly on one line: the rotation about it is known to "
        f"{number(degrees)} degrees only (one sigma), and rotation errors contain it.",
        evidence={"sigma_degrees": degrees},
    )


FAR = 3  # sigmas beyond which a movement is not explained by the uncertainty

WORDS = {
    "identical": "A and B are identical",
    "agrees": "A agrees with B",
    "close": "A is close to B",
    "differs": "A differs from B",
    "contradicts": "A contradicts B",
}


def headline_of(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the sentences for the fields of an :class:`Evaluation`."""
    sentences = [_poses(result)]
    movement: SigmaMovement | None = result["movement"]
    if movement is not None and np.isfinite(movement.median):
        sentences.append(_moved(movement))
    if result["lenses"]:
        sentences.append(_lenses(result["lenses"]))
    return tuple(sentences)


def _thing(pairs: Association) -> str:
    is_image = pairs.by in ("name", "base name", "stem") and not pairs.names[0].isdecimal()
    return "image" if is_image else "pose"


def _poses(result: Mapping[str, Any]) -> str:
    pairs, position, rotation = (result[name] for name in ("association", "position", "rotation"))
    # A truth may have many times more stamps than A.
    missing = pairs.only_a if pairs.by == "time" else pairs.only_b
    whole = len(pairs) + len(missing)
    things = plural(whole, _thing(pairs))
    of = f"{len(pairs)} of {things}" if missing else f"all {things}"
    # Images alone determine no scale. Trajectories and pose graphs have one.
    least = IDENTICAL[2] if result["verdict"] == "identical" else AGREES[0]
    scale = result["similarity"].scale
    if abs(np.log(scale)) > least and all("num_poses" in one for one in result["inputs"]):
        of += f", with A scaled by {number(scale)}"
    if result["verdict"] == "identical":
        rounded = " up to rounding errors" if max(position.max, rotation.max) > 0 else ""
        return f"{WORDS['identical']} on {of}{rounded}."
    share = 100 * position.rmse / result["size"] if result["size"] > 0 else np.inf
    return (
        f"{WORDS[result['verdict']]} on {of}: {number(position.rmse)} {result['unit']} rms in "
        f"position ({number(share)} % of the size of B), {number(rotation.rmse)} degrees rms in "
        "rotation."
    )


def _moved(movement: SigmaMovement) -> str:
    far = int((movement.sigmas > FAR).sum())
    if not movement.is_minimum:
        cost = "least squares" if movement.loss == "trivial" else f"the {movement.loss} loss"
        meaning = f"this number is not meaningful, because A is not at a minimum of {cost}"
        meaning += "; if A was refined with a loss, give it: --loss" * (movement.loss == "trivial")
    elif movement.median <= 1:
        meaning = "within the uncertainty of A"
        meaning += f", except {plural(far, 'image')} beyond {FAR}" if far else ""
    elif movement.median <= FAR:
        meaning = "about the uncertainty of A"
    else:
        meaning = "more than the uncertainty of A explains"
    if movement.assumed and movement.is_minimum:
        meaning += f", with {movement.assumed} constant"
    return (
        f"Relative poses differ by {number(movement.median)} sigmas of A's covariance (median; at "
        f"most {number(movement.largest)}): {meaning}."
    )


def _lenses(lenses: tuple[LensDifference, ...]) -> str:
    known = [lens for lens in lenses if np.isfinite(lens.pixels.rmse)]
    if not known:
        return "Lenses share no rays, so that they cannot be compared."
    if all(lens.pixels.max == 0 for lens in known):
        return "Lenses are identical."
    worst = max(known, key=lambda lens: lens.pixels.rmse)
    typical = float(np.median([lens.pixels.rmse for lens in known]))
    if len(known) == 1:
        return (
            f"Lenses differ by {number(typical)} px (rms over the image; at most "
            f"{number(worst.pixels.max)})."
        )
    return (
        f"Lenses differ by {number(typical)} px (median of {len(known)} cameras, rms over the "
        f"image; most in camera {worst.camera_a}: {number(worst.pixels.rmse)} px)."
    )
