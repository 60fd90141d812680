"""Sentences about directions of camera parameters and poses, with remedies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import WeakMode
from bundle.analysis.diagnosis.track_table import FEW_SHARED, TrackTable
from bundle.analysis.diagnosis.unknowns import CameraPart, Unknowns
from bundle.analysis.diagnosis.viewing import Viewing
from bundle.base.words import named, plural, sorted_ids

DOMINANT = 0.3
"""Share of the largest effect on pixels, below which parameters are not named."""

Floats = NDArray[np.float64]

_CAUSES = {
    "flat_scene": (
        "height",
        "the scene is flat and the images look along one direction, so that a longer focal length "
        "higher up gives the same images",
    ),
    "forward_motion": (
        "depth",
        "forward motion: the images go along their viewing direction without turning, so that a "
        "longer focal length in a deeper scene gives the same images",
    ),
    "parallel_views": (
        "depth",
        "the images look along one direction, so that a longer focal length in a deeper scene "
        "gives the same images",
    ),
    "pure_rotation": (
        "rotation",
        "pure rotation: the images stand at one place",
    ),
    "": ("the poses", "these images do not tell them apart"),
}


def mode_against_poses(
    unknowns: Unknowns,
    parts: list[CameraPart],
    cameras: list[int],
    images: NDArray[np.int64],
    look: Viewing | None,
    eigenvalue: float,
    dimension: int,
    known: str,
) -> WeakMode:
    """Return a mode in which camera parameters move against poses."""
    dominant = dominant_parts(parts)
    has_focal = any(unknowns.parameter_kind(part) == "focal" for part in dominant)
    if eigenvalue > 0:  # a weak mode, selected for its focal length
        dominant = sorted(
            {*dominant, *(p for p in parts if unknowns.parameter_kind(p) == "focal")},
            key=lambda part: (part.camera, part.parameter),
        )
        has_focal = True
    cause = look.cause if look is not None and has_focal else ""
    against, reason = _CAUSES[cause]
    names = part_names(unknowns, dominant, spoken=True)
    keys = camera_ids(unknowns, cameras)
    fixed = part_names(unknowns, dominant, spoken=False).replace(" ", "")
    target = f"camera {keys[0]}" if len(keys) == 1 else "cameras *"
    sentence = (
        f"{names[0].upper()}{names[1:]} of {named('camera', keys)} against {against}: {reason}. "
        f"{known}{' ' if known else ''}"
        f"Fix {'the focal length' if has_focal else 'it'} or give it a prior "
        f"(--set '{target}: {fixed} fixed')."
    )
    return WeakMode(
        kind=cause or "parameters_against_poses",
        sentence=sentence,
        image_ids=sorted_ids(unknowns.problem.image_ids, images),
        camera_ids=keys,
        eigenvalue=eigenvalue,
        dimension=dimension,
    )


def mode_of_poses(
    unknowns: Unknowns,
    images: NDArray[np.int64],
    direction: Floats,
    dimension: int,
    tracks: TrackTable,
) -> WeakMode:
    """Return a mode in which only poses move: parts that few points connect."""
    ids = unknowns.problem.image_ids
    for kind, pieces, how in (
        ("few_shared_points", tracks.firm_pieces, "position, rotation or scale"),
        ("scale_joint", tracks.rigid_pieces, "scale"),
    ):
        numbers, sizes = np.unique(pieces[images], return_counts=True)
        if len(numbers) < 2:
            continue
        kept = numbers[np.argmax(sizes)]
        loose = np.flatnonzero(np.isin(pieces, numbers[numbers != kept]))
        count = tracks.count_between(loose)
        if kind == "few_shared_points" and count >= FEW_SHARED:
            continue
        what = (
            f"only {plural(count, 'point')} shared with the others"
            if kind == "few_shared_points"
            else "no point is seen by two of the others as well"
        )
        return WeakMode(
            kind=kind,
            sentence=f"{named('Image', sorted_ids(ids, loose))} against the others, in "
            f"{plural(dimension, 'direction')}: {what}, which leaves {how} open. Match more points "
            "between them and the others, or hold them.",
            image_ids=sorted_ids(ids, loose),
            camera_ids=(),
            eigenvalue=0.0,
            dimension=dimension,
        )
    energy = np.zeros(len(ids))
    for image in images.tolist():
        rows = (unknowns.kind == 0) & (unknowns.index == image)
        energy[image] = float((direction[rows] ** 2).sum())
    moved = np.flatnonzero(energy > DOMINANT * energy.max()) if energy.any() else images
    return WeakMode(
        kind="undetermined_poses",
        sentence=f"{named('Image', sorted_ids(ids, moved))}: the observations leave "
        f"{plural(dimension, 'direction')} of the poses open.",
        image_ids=sorted_ids(ids, moved),
        camera_ids=(),
        eigenvalue=0.0,
        dimension=dimension,
    )


def dominant_parts(parts: list[CameraPart]) -> list[CameraPart]:
    """Return the parameters with the largest effect on pixels."""
    most = max(part.pixels for part in parts)
    return [part for part in parts if part.pixels >= DOMINANT * most]


def part_names(unknowns: Unknowns, parts: list[CameraPart], *, spoken: bool) -> str:
    """Return the parameter names without repeats; if spoken, in words like "focal length"."""
    names = []
    for part in parts:
        name = unknowns.parameter_name(part)
        if spoken:
            spoken_names = {"focal": "focal length", "principal_point": "principal point"}
            name = spoken_names.get(unknowns.parameter_kind(part), name)
        names.append(name)
    different = list(dict.fromkeys(names))
    if not spoken or len(different) == 1:
        return ", ".join(different)
    return f"{', '.join(different[:-1])} and {different[-1]}"


def camera_ids(unknowns: Unknowns, cameras: list[int]) -> tuple[int, ...]:
    """Return the ids of cameras by their indices."""
    return sorted_ids(unknowns.problem.camera_ids, np.array(cameras, np.int64))
