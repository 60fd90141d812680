"""Words for directions that observations do not determine.

A solver returns an arbitrary basis of the null space. Two unknowns belong together if the projector
onto the null space couples them. The blocks of the projector are independent deficiencies, and the
trace of a block is the dimension of its deficiency, for any basis. Three things determine
the kind of a deficiency: the moving unknowns (camera parameters, poses or both), the viewing
geometry of its images, and the points that connect them (track_table.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnosis_result import CollapsedCluster, Component, WeakMode
from bundle.analysis.diagnosis.findings import CameraPart, EquationCounts, Unknowns
from bundle.analysis.diagnosis.track_table import FEW_SHARED, TrackTable, Viewing, viewing
from bundle.base.components import component_roots
from bundle.base.records import dataclass
from bundle.base.words import named, plural, sorted_ids
from bundle.model.problem import Problem

COUPLED = 1e-3  # entries of the projector below this limit count as zero
WEAK = 1e-4  # eigenvalues above this limit are not weak
UNCERTAIN = 1e-3
"""Share of the focal length that a weak direction leaves undetermined with one pixel of noise."""
Floats = NDArray[np.float64]


def null_modes(
    unknowns: Unknowns,
    directions: Floats,
    tracks: TrackTable,
    collapsed: tuple[CollapsedCluster, ...],
    counts: EquationCounts,
) -> list[WeakMode]:
    """Return the modes of null ``directions`` (num_unknowns, count) that are not gauge."""
    modes = list(_unseen(unknowns, tracks))
    for rows in _blocks(unknowns, directions):
        own = directions[rows]
        dimension = round(float((own**2).sum()))
        if dimension == 0:  # the block holds only rounding errors
            continue
        # Direction of the block with the largest motion.
        _, _, across = np.linalg.svd(own, full_matrices=False)
        strongest = np.zeros(len(directions))
        strongest[rows] = own @ across[0]
        modes.append(_describe(unknowns, strongest, rows, dimension, tracks, counts))
    return _without_collapsed(unknowns.problem, modes, collapsed)


def weak_modes(
    unknowns: Unknowns,
    eigenvalues: Floats,
    directions: Floats,
    tracks: TrackTable,
    known: Sequence[WeakMode],
) -> list[WeakMode]:
    """Return the weak directions with a known cause; directions of one cause are merged.

    Long chains and loose ends have small eigenvalues without an error. A direction therefore counts
    only if it leaves a focal length undetermined because of the viewing geometry.

    ``eigenvalues``: eigenvalues, ascending. ``directions``: one direction per column. ``known``:
    null modes; their causes are not repeated.
    """
    by_cause: dict[str, _Weakness] = {}
    for value, direction in zip(eigenvalues.tolist(), directions.T, strict=True):
        if value > WEAK:
            break
        parts = unknowns.camera_parts(direction / np.sqrt(value))
        focal = [part for part in parts if unknowns.parameter_kind(part) == "focal"]
        shares = [abs(part.amount) / unknowns.focal(part.camera) for part in focal]
        if not shares or max(shares) < UNCERTAIN:
            continue
        moved = [part for part, share in zip(focal, shares, strict=True) if share > max(shares) / 3]
        cameras = sorted({part.camera for part in moved})
        # All images that observe a point determine it, so their common configuration counts.
        pieces = np.unique(tracks.pieces[unknowns.images_of_cameras(cameras)])
        look = viewing(unknowns.problem, np.flatnonzero(np.isin(tracks.pieces, pieces)))
        if look is None or not look.cause or look.cause in {mode.kind for mode in known}:
            continue
        found = by_cause.setdefault(look.cause, _Weakness(look, value, cameras, parts))
        for part in focal:
            found.squares[part.camera] = found.squares.get(part.camera, 0.0) + part.amount**2
    return [_weak(unknowns, weakness) for weakness in by_cause.values()]


@dataclass
class _Weakness:
    """Weak directions of one cause: the first one, and squared undetermined shares by camera."""

    look: Viewing
    eigenvalue: float
    cameras: list[int]
    parts: list[CameraPart]
    squares: dict[int, float] = field(default_factory=dict)


def _weak(unknowns: Unknowns, weakness: _Weakness) -> WeakMode:
    camera = max(weakness.cameras, key=lambda one: weakness.squares[one] / unknowns.focal(one) ** 2)
    known = (
        f"Noise of 1 px makes the focal length of {unknowns.focal(camera):.4g} px uncertain by "
        f"{weakness.squares[camera] ** 0.5:.3g} px."
    )
    images = unknowns.images_of_cameras(weakness.cameras)
    look, value = weakness.look, weakness.eigenvalue
    return mode_against_poses(
        unknowns, weakness.parts, weakness.cameras, images, look, value, 1, known
    )


def _without_collapsed(
    problem: Problem, modes: list[WeakMode], collapsed: tuple[CollapsedCluster, ...]
) -> list[WeakMode]:
    """Return the modes; those of images on which points have collapsed are merged into one."""
    images = {image for cluster in collapsed for image in cluster.image_ids}
    own = np.isin(problem.image_ids, sorted(images))
    cameras = set(problem.camera_ids[problem.image_camera[own]].tolist())
    concerned = [
        mode for mode in modes if images & {*mode.image_ids} or cameras & {*mode.camera_ids}
    ]
    if not concerned:
        return modes
    dimension = sum(mode.dimension for mode in concerned)
    named_images = tuple(sorted({image for mode in concerned for image in mode.image_ids}))
    named_cameras = tuple(sorted({key for mode in concerned for key in mode.camera_ids}))
    return [
        WeakMode(
            kind="collapsed_scale",
            sentence=f"{plural(dimension, 'null direction')} of images on which points have "
            f"collapsed in scale, and of their cameras ({named('image', named_images)}): their "
            "derivatives are so large that all other observations are lost to rounding.",
            image_ids=named_images,
            camera_ids=named_cameras,
            dimension=dimension,
        ),
        *(mode for mode in modes if mode not in concerned),
    ]


def _unseen(unknowns: Unknowns, tracks: TrackTable) -> Iterator[WeakMode]:
    """Yield modes of parameters that no observation determines."""
    problem = unknowns.problem
    entities = unknowns.entities()
    for entity in np.unique(entities[unknowns.unseen]):
        rows = np.flatnonzero((entities == entity) & unknowns.unseen)
        if unknowns.of_camera[rows[0]]:
            camera = int(unknowns.index[rows[0]])
            names = ", ".join(
                unknowns.parameter_name(CameraPart(camera, int(unknowns.coordinate[row]), 0, 0))
                for row in rows
            )
            key = int(problem.camera_ids[camera])
            yield WeakMode(
                kind="unobserved_parameter",
                sentence=f"Unobserved: {names} of camera {key}, which no observation depends on. "
                f"Fix it (--set 'camera {key}: {names.replace(' ', '')} fixed').",
                camera_ids=(key,),
                dimension=len(rows),
            )
            continue
        images = unknowns.images(rows)
        ids = sorted_ids(problem.image_ids, images)
        shared = int(tracks.shared[images].sum())
        yield WeakMode(
            kind="unobserved_pose",
            sentence=f"{named('Image', ids)}: nothing determines the pose in "
            f"{plural(len(rows), 'direction')}; {plural(shared, 'point')} shared with "
            "other images.",
            image_ids=ids,
            dimension=len(rows),
        )


def _blocks(unknowns: Unknowns, directions: Floats) -> Iterator[NDArray[np.int64]]:
    """Yield the unknowns of each block of the projector onto the null space."""
    entities = unknowns.entities()
    active = np.flatnonzero((directions**2).sum(axis=1) > COUPLED**2)
    if not len(active):
        return
    used, numbers = np.unique(entities[active], return_inverse=True)
    ends: list[NDArray[np.int64]] = []
    for one in range(len(used)):
        coupled = np.abs(directions[active[numbers == one]] @ directions[active].T) > COUPLED
        others = np.unique(numbers[coupled.any(axis=0)])
        ends.append(np.stack([np.full(len(others), one), others], axis=1))
    pairs = np.concatenate(ends)
    roots = component_roots(pairs.ravel(), np.arange(0, 2 * len(pairs), 2), len(used))
    for root in np.unique(roots):
        yield active[roots[numbers] == root]


def _describe(
    unknowns: Unknowns,
    direction: Floats,
    rows: NDArray[np.int64],
    dimension: int,
    tracks: TrackTable,
    counts: EquationCounts,
) -> WeakMode:
    parts = unknowns.camera_parts(direction)
    poses = rows[unknowns.of_pose[rows]]
    images = unknowns.images(poses)
    if not parts:
        return mode_of_poses(unknowns, images, direction, dimension, tracks)
    dominant = dominant_parts(parts)
    cameras = sorted({part.camera for part in dominant})
    if not len(poses):
        kind = "unobserved_parameter"
        names = part_names(unknowns, dominant, spoken=False)
        key = ", ".join(str(unknowns.problem.camera_ids[camera]) for camera in cameras)
        reason = (
            "no observation depends on it"
            if len(dominant) == 1
            else ("the observations depend on one combination of them only")
        )
        return WeakMode(
            kind=kind,
            sentence=f"Unobserved: {names} of {named('camera', camera_ids(unknowns, cameras))}; "
            f"{reason}. Fix one of them (--set 'camera {key}: {names.split(', ')[-1]} fixed').",
            camera_ids=camera_ids(unknowns, cameras),
            dimension=dimension,
        )
    seen = unknowns.images_of_cameras(cameras)
    short = counts.mode(images, dimension)
    if short is not None:
        return short
    look = viewing(unknowns.problem, seen)
    return mode_against_poses(unknowns, parts, cameras, images, look, 0.0, dimension, "")


DOMINANT = 0.3  # share of the largest effect on pixels, below which parameters are not named


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
    "": ("the poses", "these images cannot distinguish them"),
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
            else "none of their points is seen by two of the others"
        )
        return WeakMode(
            kind=kind,
            sentence=f"{named('Image', sorted_ids(ids, loose))} relative to the others: {what}, "
            f"which does not determine {how} ({plural(dimension, 'direction')}). Match more "
            "points between them and the others, or fix them.",
            image_ids=sorted_ids(ids, loose),
            dimension=dimension,
        )
    energy = np.zeros(len(ids))
    for image in images.tolist():
        rows = (unknowns.kind == 0) & (unknowns.index == image)
        energy[image] = float((direction[rows] ** 2).sum())
    moved = np.flatnonzero(energy > DOMINANT * energy.max()) if energy.any() else images
    return WeakMode(
        kind="undetermined_poses",
        sentence=f"{named('Image', sorted_ids(ids, moved))}: the observations do not "
        f"determine {plural(dimension, 'direction')} of the poses.",
        image_ids=sorted_ids(ids, moved),
        dimension=dimension,
    )


def dominant_parts(parts: list[CameraPart]) -> list[CameraPart]:
    """Return the parameters with the largest effect on pixels."""
    most = max(part.pixels for part in parts)
    return [part for part in parts if part.pixels >= DOMINANT * most]


def part_names(unknowns: Unknowns, parts: list[CameraPart], *, spoken: bool) -> str:
    """Return the parameter names without repeats; ``spoken``: in words like "focal length"."""
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


MOST_IMAGES = 200
"""Largest number of images of a component that the search for the nearest pair uses."""
MOST_PIECES = 100
SIMILARITY = 7


def component_modes(
    problem: Problem, tracks: TrackTable, components: tuple[Component, ...]
) -> list[WeakMode]:
    """Return a mode for each component but the largest, with advice on connecting it."""
    modes = []
    for part in components[1:]:
        near = _nearest(problem, tracks, part.image_ids)
        modes.append(
            WeakMode(
                kind="component",
                sentence=f"{named('Image', part.image_ids)} ({plural(part.num_points, 'point')}): "
                "no point is shared with the largest component "
                f"({plural(len(components[0].image_ids), 'image')}), so that their relative "
                "position, rotation and scale are arbitrary. Match points between the nearest "
                f"images, {near[0]} and {near[1]} "
                f"({plural(near[2], 'point')} of the former and {near[3]} of the latter are seen "
                "by at most two images).",
                image_ids=part.image_ids,
                dimension=SIMILARITY,
            )
        )
    return modes


def rotation_modes(problem: Problem, tracks: TrackTable, counts: EquationCounts) -> list[WeakMode]:
    """Return a mode for each component whose images all have the same position.

    If a component has too few equations to determine positions, its mode says so.
    """
    modes = []
    for piece in range(min(int(tracks.pieces.max(initial=-1)) + 1, MOST_PIECES)):
        images = np.flatnonzero(tracks.pieces == piece)
        look = viewing(problem, images) if len(images) > 1 else None
        if look is None or look.cause != "pure_rotation":
            continue
        short = counts.mode(images, 0)
        if short is not None:
            modes.append(short)
            continue
        ids = tuple(sorted(problem.image_ids[images].tolist()))
        modes.append(
            WeakMode(
                kind="pure_rotation",
                sentence=f"Pure rotation: {named('image', ids)} stand at one place (within "
                f"{look.baseline:.1g} of the distance of their points): no point has a depth and "
                "the scale is arbitrary. Add images from elsewhere, or fix the points.",
                image_ids=ids,
                dimension=0,
            )
        )
    return modes


def _nearest(
    problem: Problem, tracks: TrackTable, part: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Return the ids of the nearest pair of images, one of the part and one of the main component.

    For each of them, also return the number of its points that at most one other image sees.
    """
    own = np.flatnonzero(np.isin(problem.image_ids, part))[:MOST_IMAGES]
    main = np.flatnonzero(tracks.pieces == 0)
    centers = problem.projection_centers
    gaps = np.linalg.norm(centers[own][:, None] - centers[main][None], axis=2)
    first, second = np.unravel_index(int(gaps.argmin()), gaps.shape)
    a, b = int(own[first]), int(main[second])
    short = tracks.lengths[tracks.points] <= 2
    counts = [int((short & (tracks.images == image)).sum()) for image in (a, b)]
    return int(problem.image_ids[a]), int(problem.image_ids[b]), counts[0], counts[1]
