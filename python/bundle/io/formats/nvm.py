"""VisualSFM's NVM files, version 3, and their variant R9T of Multicore Bundle Adjustment.

A camera has f, a rotation as quaternion qw qx qy qz, its centre C and a distortion r. The
projection m of a world point X, x to the right and y down from the centre of the image, solves

    P = R (X - C),    p = (P_x, P_y) / P_z,    (1 + r |m / f|^2) m = f p:

the distortion acts on the measurement. COLMAP has no such lens; with r = 0 it is SIMPLE_PINHOLE,
otherwise RADIAL is fitted (docs/from_your_tool.md: sizes, COLMAP's own files, lost digits).

R9T has R, row by row, and t = -R C in place of the quaternion and C. A space in the name of an
image is written as ".

Source: http://ccwu.me/vsfm/doc.html#nvm and PBA (C. Wu et al., Multicore Bundle Adjustment, 2011).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_distinct
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.io import bal
from bundle.io.atomic.replaced_paths import NoteWarning
from bundle.io.formats.bundler import moved_centers
from bundle.io.formats.file_values import Head, number_of
from bundle.io.formats.imported_model import (
    NUM_RADII,
    Imported,
    checked_rotations,
    fitted_lens,
    pixels,
    unique_keys,
)
from bundle.io.formats.read_options import UNKNOWN_SIZES, ReadOptions, image_sizes
from bundle.io.formats.written_tracks import (
    check_names,
    colors_of,
    common_losses,
    keys_of,
    names_of,
    write_tracks,
)
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.rigid_motions import quaternion_from_matrix, quaternion_rotate, rotation_matrices

_FIELDS = "f qw qx qy qz cx cy cz r 0"
_FIELDS_R9T = "f r11 r12 r13 r21 r22 r23 r31 r32 r33 t1 t2 t3 r 0"
_UNKNOWN_CENTER = (
    "Image sizes are unknown: the principal point is the middle of the observations. "
    "--image-size W,H gives it."
)
SPACE = '"'  # character of the file for a space in the name of an image
LENGTHS = (0.9, 1.1)  # range of quaternion lengths that are normalised; other lengths are refused
STEPS = tuple(10.0**power for power in range(4, -5, -1))
"""Steps of coordinates that count as rounded, in units of the file."""
LARGEST_ROUNDING = 1.0
"""Largest movement of pixels by rounded coordinates without a note, in pixels."""
LARGEST_SAMPLE = 10_000  # number of observations that suffice for a median
_MARGIN = 1.05  # of the radius of the farthest observation


def read(path: Path, options: ReadOptions) -> Problem:
    """Read an NVM model.

    Raises:
        InputError: the file violates its format, or has several models.
        OSError: a file cannot be read.
    """
    names, cameras, num_points, head, center = _head(path)
    tracks = _core.read_point_tracks(
        path, head.position, head.num_lines, len(cameras), num_points, options.progress
    )
    _check_end(path, tracks)
    known = all((path.parent / name).is_file() for name in names)
    sizes = image_sizes(
        names if known or options.image_size is not None else ("",) * len(names),
        [path.parent],
        options,
        shown(path),
    )
    is_corner = options.pixel_origin == "corner"
    rounded = _rounding(cameras, tracks)
    if rounded:
        warnings.warn(f"{shown(path)}: {rounded}", NoteWarning, stacklevel=2)
    return _imported(path, cameras, tracks, names, sizes, center, is_corner).problem()


def _head(
    path: Path,
) -> tuple[list[str], NDArray[np.float64], int, Head, NDArray[np.float64] | None]:
    """Return names and numbers of cameras, number of points, position after, fixed centre."""
    head = Head(path)
    try:
        first = head.next_line("NVM_V3").split()
        if first[0] not in (b"NVM_V3", b"NVM_V3_R9T"):
            head.fail("NVM_V3 or NVM_V3_R9T", brief(first[0].decode(errors="replace")))
        has_matrices = first[0] == b"NVM_V3_R9T"
        fields = _FIELDS_R9T if has_matrices else _FIELDS
        count = len(fields.split())
        fixed = [number_of(token) for token in first[2:]] if first[1:2] == [b"FixedK"] else []
        center = None
        if len(first) > 1:
            if len(fixed) not in (4, 5) or None in fixed or fixed[0] != fixed[2]:
                head.fail("NVM_V3, or NVM_V3 FixedK f cx f cy r, with one f", "another first line")
            center = np.array([fixed[1], fixed[3]], float)
        num_cameras = head.count("the number of cameras")
        names, rows = [], []
        for camera in range(num_cameras):
            what = f"camera {camera}: name {fields}"
            words = head.next_line(what).rsplit(None, count)
            numbers = [number_of(word) for word in words[1:]]
            if len(numbers) < count or None in numbers:
                head.fail(what, "another line")
            for name, wanted, value in _fixed_values(fixed, numbers):
                if not math.isclose(wanted, value, rel_tol=1e-5):
                    head.fail(f"{name} = {wanted:g} of the first line in all cameras", f"{value:g}")
            names.append(words[0].decode(errors="surrogateescape").replace(SPACE, " "))
            rows.append(numbers)
        num_points = head.count("the number of points", 2**31 - 1)
    finally:
        head.close()
    check_distinct(f"{shown(path)}: expected each image once", names)
    cameras = np.array(rows, float).reshape(-1, count)
    if has_matrices:
        cameras = _with_quaternions(path, cameras)
    return names, cameras, num_points, head, center


def _fixed_values(fixed: list[Any], numbers: list[Any]) -> Iterator[tuple[str, float, float]]:
    """Yield values of the first line of a file (FixedK f cx f cy r) that all cameras have."""
    if fixed:
        yield "the focal length f", fixed[0], numbers[0]
    if len(fixed) == 5:
        yield "the distortion r", fixed[4], numbers[-2]


def _with_quaternions(path: Path, cameras: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return cameras of R9T (n, 15) in the form of NVM_V3 (n, 10)."""
    rotations = checked_rotations(
        cameras[:, 1:10].reshape(-1, 3, 3), lambda k: f"{shown(path)}: camera {k}"
    )
    centers = -np.einsum("nji,nj->ni", rotations, cameras[:, 10:13])
    wxyz = quaternion_from_matrix(rotations)[:, [3, 0, 1, 2]]
    return np.column_stack([cameras[:, 0], wxyz, centers, cameras[:, 13:]])


def _check_end(path: Path, tracks: dict[str, Any]) -> None:
    """Refuse a second model; after the models there is 0, or comments and a list of files."""
    after = tracks["next"].decode(errors="replace")
    if not after or after.startswith("#") or after == "0":
        return
    found = f"another model, of {after} images" if after.isdigit() else brief(after)
    raise InputError(
        f"{shown(path)}:{tracks['next_line']}: expected one model, found {found}; "
        "VisualSFM saves one model by itself (SfM, Save Current Model)"
    )


def _imported(
    path: Path,
    cameras: NDArray[np.float64],
    tracks: dict[str, Any],
    names: list[str],
    sizes: NDArray[np.int64],
    fixed_center: NDArray[np.float64] | None,
    is_corner: bool,
) -> Imported:
    focal, wxyz, position, distortion = (
        cameras[:, 0],
        cameras[:, 1:5],
        cameras[:, 5:8],
        cameras[:, 8],
    )
    lengths = np.linalg.norm(wxyz, axis=1)
    for what, wrong in (
        ("a focal length above 0", ~(focal > 0)),
        ("a quaternion of length 1", ~((LENGTHS[0] < lengths) & (lengths < LENGTHS[1]))),
    ):
        if wrong.any():
            camera = int(np.argmax(wrong))
            raise InputError(f"{shown(path)}: camera {camera}: expected {what}, found another")
    q = wxyz[:, [1, 2, 3, 0]] / lengths[:, None]
    image, xy = tracks["image"], tracks["xy"]
    center = sizes / 2 if fixed_center is None else np.tile(fixed_center, (len(cameras), 1))
    notes = []
    if fixed_center is None and not sizes.all() and len(cameras):
        if is_corner and len(xy):
            center = np.where(sizes > 0, center, (xy.min(axis=0) + xy.max(axis=0)) / 2)
            notes.append(_UNKNOWN_CENTER)
        else:
            notes.append(UNKNOWN_SIZES)
    if is_corner:
        xy = xy - center[image]
    key = unique_keys(image, tracks["key"])
    if key is None and len(image):
        notes.append("Keypoint numbers are not used: one occurs twice in an image.")
    params = np.zeros((len(cameras), 5))
    params[:, 0], params[:, 1:3] = focal, center
    error = _fit(path, params, distortion, image, xy, notes)
    rotations = rotation_matrices(q)

    def project(i: NDArray[np.int32], points: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = np.einsum("nij,nj->ni", rotations[i], points - position[i])
        p = inside[:, :2] / inside[:, 2:]
        scale = undistorted_scale(np.hypot(p[:, 0], p[:, 1]), distortion[i])
        projected: NDArray[np.float64] = (focal[i] * scale)[:, None] * p
        return projected

    return Imported(
        path=path,
        fields={
            "cam_from_world": np.column_stack([q, -quaternion_rotate(q, position)]),
            "image_names": tuple(names),
            "image_camera": np.arange(len(cameras), dtype=np.int32),
            "camera_models": tuple("RADIAL" if r else "SIMPLE_PINHOLE" for r in distortion),
            "camera_params": params,
            "camera_sizes": sizes,
            "points": tracks["points"],
            "observation_image": image,
            "observation_point": tracks["point"],
            "observation_xy": pixels(xy, image, (1.0, 1.0), np.array(center, float)),
            **({} if key is None else {"observation_keypoint": key}),
            "format": "nvm",
        },
        colors=tracks["colors"],
        project=project,
        measured=xy,
        unit=np.ones(len(cameras)),
        fit_error=error,
        notes=notes,
        data={"distortion": distortion, "params": params},
    )


def _rounding(cameras: NDArray[np.float64], tracks: dict[str, Any]) -> str:
    """Return a sentence about coordinates whose rounding moves pixels; "" if it does not."""
    points, centers, image = tracks["points"], cameras[:, 5:8], tracks["image"]
    if not len(image):
        return ""
    every = np.concatenate([points, centers])
    step = max(map(_step, every.T))
    sample = slice(None, None, 1 + len(image) // LARGEST_SAMPLE)
    image = image[sample]
    distance = np.linalg.norm(points[tracks["point"][sample]] - centers[image], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = step * float(np.median(cameras[image, 0] / distance))
    if not moved > LARGEST_ROUNDING:
        return ""
    return (
        f"coordinates of up to {np.abs(every).max():.3g} are rounded to multiples of {step:g}, "
        f"which moves pixels by up to {moved:.2g} and makes poses and points wrong; export "
        "coordinates about a local origin"
    )


def _step(values: NDArray[np.float64]) -> float:
    """Return the step to which at least five digits of all values are rounded, or 0."""
    largest = np.abs(values).max()
    for step in STEPS:
        if largest >= 1e4 * step:
            scaled = values / step
            if (np.abs(scaled - np.rint(scaled)) < 1e-6).all():
                return step
    return 0.0


def undistorted_scale(
    radius: NDArray[np.float64], distortion: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return s / radius, where s solves s (1 + r s^2) = radius on the branch from 0."""
    s = radius.copy()
    for _ in range(30):
        step = (s * (1 + distortion * s * s) - radius) / (1 + 3 * distortion * s * s)
        s -= step
        if not (np.abs(step) > 1e-15 * np.abs(s)).any():
            break
    folded = 1 + 3 * distortion * s * s <= 0
    return np.where(folded, np.nan, np.divide(s, radius, out=np.ones_like(s), where=radius > 0))


def _fit(
    path: Path,
    params: NDArray[np.float64],
    distortion: NDArray[np.float64],
    image: NDArray[np.int32],
    xy: NDArray[np.float64],
    notes: list[str],
) -> float:
    """Fit RADIAL to each distorted lens, in place; return the largest error in pixels."""
    distorted = np.flatnonzero(distortion)
    if not len(distorted):
        return 0.0
    farthest = np.zeros(len(params))
    np.maximum.at(farthest, image, np.sqrt((xy * xy).sum(axis=1)))
    worst = 0.0
    for camera in distorted.tolist():
        focal, r = params[camera, 0], distortion[camera]
        radius = _MARGIN * farthest[camera] if farthest[camera] else focal / 2
        s = np.linspace(0, radius / focal, NUM_RADII + 1)[1:]
        fit = None
        if (1 + 3 * r * s * s > 0).all():  # otherwise the lens is folded
            fit = fitted_lens(
                "RADIAL", focal, params[camera, 1:3], np.arctan(s * (1 + r * s * s)), s * focal
            )
        if fit is None:
            raise InputError(
                f"{shown(path)}: camera {camera}: expected a distortion without a fold within "
                f"{radius:.4g} px, found r = {r:g}"
            )
        params[camera] = fit.params
        worst = max(worst, fit.error)
    notes.append(
        f"RADIAL was fitted to the {plural(len(distorted), 'lens', 'lenses')} with distortion, "
        f"because NVM distorts the measurement; the largest error is {worst:.2g} px."
    )
    return worst


# Writer.
#
# The distortion r of NVM acts on the measurement. A lens of COLMAP with distortion is fitted: over
# radii s of the image in focal lengths, r minimises the sum of (s (1 + r s^2) - t)^2, where t is
# the tangent of the ray whose image is s. A lens that was read from NVM and has not changed keeps
# its r.

_NUM_RADII = 64


MOST_ERROR = 2.0
"""Largest error of a fitted distortion in pixels; lenses with a larger one are refused."""


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: a camera or a name cannot be written.
    """
    _, error = _distortion(problem, bal.radial_params(problem, "an NVM file"))
    if error > MOST_ERROR:
        raise InputError(
            "camera_params: an NVM file cannot hold them: expected lenses that its one coefficient "
            f"of distortion fits to {MOST_ERROR:g} px, found an error of {error:.3g} px"
        )
    check_names(problem, "an NVM file", "\n\r\t" + SPACE)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write an NVM file; return sentences on information that is lost."""
    params = bal.radial_params(problem, "an NVM file")
    distortion, error = _distortion(problem, params)
    pose = problem.cam_from_world
    q = pose[:, [3, 0, 1, 2]] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rows = np.column_stack([params[:, 0], q, problem.projection_centers, distortion])
    image = problem.observation_image
    xy = problem.observation_xy - params[image, 1:3]
    with path.open("w", encoding="utf-8", errors="surrogateescape") as file:
        file.write(f"NVM_V3 \n\n{problem.num_images}\n")
        for name, row in zip(names_of(problem), rows.tolist(), strict=True):
            file.write(name.replace(" ", SPACE) + "\t" + "%r " * 9 % tuple(row) + "0\n")
        file.write(f"\n{problem.num_points}\n")
        write_tracks(
            file,
            ("%r %r %r %d %d %d %d", " %d %d %r %r", "\n"),
            np.column_stack([problem.points, colors_of(problem)]),
            np.column_stack([image, keys_of(problem), xy]),
            problem.observation_point,
        )
        file.write("\n0\n")
    fitted = (
        ()
        if not error
        else (f"Distortion was fitted by NVM's formula; the largest error is {error:.2g} px.",)
    )
    return (
        *common_losses(problem, keeps=("names", "colors")),
        *moved_centers(problem),
        *fitted,
    )


def _distortion(problem: Problem, params: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return r of each image, and the largest error of the fits in pixels."""
    distortion, worst = np.zeros(len(params)), 0.0
    known = _known(problem)
    farthest = np.zeros(len(params))
    offset = problem.observation_xy - params[problem.observation_image, 1:3]
    np.maximum.at(farthest, problem.observation_image, np.hypot(offset[:, 0], offset[:, 1]))
    for image in np.flatnonzero(params[:, 3:].any(axis=1)).tolist():
        focal, _, _, k1, k2 = params[image]
        if image in known:
            distortion[image] = known[image]
            continue
        t = np.linspace(0, 2, 8 * _NUM_RADII + 1)[1:]
        s = t * (1 + k1 * t**2 + k2 * t**4)
        seen = np.cumprod(np.diff(s, prepend=0.0) > 0, dtype=bool)
        limit = farthest[image] / focal or 0.5
        seen &= s <= max(limit, s[0])
        t, s = t[seen], s[seen]
        r = float((s**3 @ (t - s)) / (s**3 @ s**3))
        distortion[image] = r
        slope = np.abs(1 + 3 * r * s**2)
        error = float((np.abs(s * (1 + r * s**2) - t) / slope).max() * focal)
        worst = max(worst, error)
    return distortion, worst


def _known(problem: Problem) -> dict[int, float]:
    """Return r by image, for images whose lens is as it was read."""
    source = imported_source(problem)
    if problem.format != "nvm" or source is None:
        return {}
    before, values = source.data["params"], source.data["distortion"]
    found = {}
    for image, (image_id, camera) in enumerate(
        zip(problem.image_ids.tolist(), problem.image_camera.tolist(), strict=True)
    ):
        own = problem.camera_params[camera]
        if 0 <= image_id < len(before) and np.array_equal(own, before[image_id][: len(own)]):
            found[image] = float(values[image_id])
    return found
