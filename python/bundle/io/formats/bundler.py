"""Bundler's bundle.out, version 0.3, with the names of its images in list.txt.

A camera has f, k1, k2, a rotation R and a translation t. Its projection of a world point X is

    P = R X + t,    p = -(P_x, P_y) / P_z,    x = f (1 + k1 |p|^2 + k2 |p|^4) p,

with x to the right and y up from the centre of the image: the camera looks along -z. COLMAP's
camera frame is S P with S = diag(1, -1, -1), and its pixels are u = w/2 + x, v = h/2 - y. Its
RADIAL model has the same distortion. A camera with f = 0 is not registered. The file has no
image sizes; if they remain unknown, the principal point is the origin, as in BAL files.

Source: https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.4-manual.html
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_distinct, refuse_row
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.io import bal
from bundle.io.atomic import atomic_write as atomic
from bundle.io.formats.file_values import Head
from bundle.io.formats.imported_model import (
    Imported,
    checked_rotations,
    pixels,
    poses_of,
    unique_keys,
)
from bundle.io.formats.read_options import UNKNOWN_SIZES, ReadOptions, image_sizes
from bundle.io.formats.written_tracks import (
    check_names,
    colors_of,
    common_losses,
    keys_of,
    write_tracks,
)
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.rigid_motions import rotation_matrices

LIST = "list.txt"
FLIP = np.array([1.0, -1.0, -1.0])  # diagonal of S, COLMAP's camera frame from Bundler's

_AXES = (
    "; cameras of the format look along -z: export RealityCapture's or RealityScan's "
    '"Bundler v0.3 (negative Z)", not "Bundler v0.3"'
)
_NUMBERS = 15
_LINE = re.compile(r"(.*?)(?:\s+\d+(?:\s+[-+.\deE]+)?)?\s*")


def read(path: Path, options: ReadOptions) -> Problem:
    """Read a Bundler model.

    Raises:
        InputError: the file violates its format, or the sizes of the images cannot be found.
        OSError: a file cannot be read.
    """
    cameras, num_points, head = _head(path)
    tracks = _core.read_point_tracks(
        path, head.position, head.num_lines, len(cameras), num_points, options.progress
    )
    if tracks["next"]:
        found = brief(tracks["next"].decode(errors="replace"))
        raise InputError(
            f"{shown(path)}:{tracks['next_line']}: expected the end of the file after "
            f"{num_points} points, found {found}"
        )
    names, sizes = _names_and_sizes(path, len(cameras), options)
    return _imported(path, cameras, tracks, names, sizes).problem()


def _head(path: Path) -> tuple[NDArray[np.float64], int, Head]:
    """Return the cameras' numbers (n, 15), the number of points, and the position after them."""
    head = Head(path)
    try:
        first = head.next_line("# Bundle file v0.3")
        if re.fullmatch(rb"#\s*Bundle file v0\.[34]", first) is None:
            head.fail("# Bundle file v0.3", brief(first.decode(errors="replace")))
        num_cameras = head.count("the number of cameras")
        num_points = head.count("the number of points", 2**31 - 1)
        rows = [
            [head.number(f"15 numbers of camera {camera}") for _ in range(_NUMBERS)]
            for camera in range(num_cameras)
        ]
    finally:
        head.close()
    return np.array(rows).reshape(-1, _NUMBERS), num_points, head


def _names_and_sizes(
    path: Path, count: int, options: ReadOptions
) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    folder = path.parent
    listed = options.image_list
    if listed is None:
        beside = (folder / f"{path.stem}.{LIST}", folder / LIST, folder.parent / LIST)
        listed = next((file for file in beside if file.is_file()), None)
    names = ("",) * count if listed is None else image_names(listed, count)
    folders = [folder, folder.parent, *([] if listed is None else [listed.parent])]
    place = shown(path if listed is None else listed)
    return names, image_sizes(names, folders, options, place)


def image_names(path: Path, count: int) -> tuple[str, ...]:
    """Return the names of the images in list.txt, one a line, with or without a focal length."""
    text = path.read_text("utf-8-sig", errors="surrogateescape")
    matches = [_LINE.fullmatch(line) for line in text.splitlines() if line.strip()]
    names = tuple(match[1].removeprefix("./") for match in matches if match is not None)
    if len(names) != count:
        raise InputError(
            f"{shown(path)}: expected {plural(count, 'image')}, one a line, as in the Bundler "
            f"file, found {len(names)}"
        )
    check_distinct(f"{shown(path)}: expected each name once", names)
    return names


def _imported(
    path: Path,
    cameras: NDArray[np.float64],
    tracks: dict[str, Any],
    names: tuple[str, ...],
    sizes: NDArray[np.int64],
) -> Imported:
    registered = np.flatnonzero(cameras[:, 0] > 0)
    negative = np.flatnonzero(cameras[:, 0] < 0)
    if len(negative):
        raise InputError(
            f"{shown(path)}: camera {negative[0]}: expected a focal length above 0, or 0 for an "
            f"image that is not registered, found {cameras[negative[0], 0]:g}"
        )
    image, notes = _registered(path, registered, len(cameras), tracks)
    chosen = cameras[registered]
    rotations, shift = chosen[:, 3:12].reshape(-1, 3, 3), chosen[:, 12:]
    nearest = checked_rotations(rotations, lambda k: f"{shown(path)}: camera {registered[k]}")
    center = sizes[registered] / 2
    key = unique_keys(image, tracks["key"])
    if not sizes[registered].all() and len(registered):
        notes.append(UNKNOWN_SIZES)
    if key is None and len(image):
        notes.append("Keypoint numbers are not used: one occurs twice in an image.")

    def project(i: NDArray[np.int32], points: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = np.einsum("nij,nj->ni", rotations[i], points) + shift[i]
        p = -inside[:, :2] / inside[:, 2:]
        f, k1, k2 = chosen[i, 0], chosen[i, 1], chosen[i, 2]
        r2 = (p * p).sum(axis=1)
        scaled: NDArray[np.float64] = (f * (1 + k1 * r2 + k2 * r2 * r2))[:, None] * p
        return scaled

    return Imported(
        path=path,
        fields={
            "cam_from_world": poses_of(FLIP[:, None] * nearest, FLIP * shift),
            "image_ids": registered,
            "image_names": tuple(names[k] for k in registered),
            "image_camera": np.arange(len(registered), dtype=np.int32),
            "camera_ids": registered,
            "camera_models": ("RADIAL",) * len(registered),
            "camera_params": np.column_stack([chosen[:, 0], center, chosen[:, 1:3]]),
            "camera_sizes": sizes[registered],
            "points": tracks["points"],
            "observation_image": image,
            "observation_point": tracks["point"],
            "observation_xy": pixels(tracks["xy"], image, (1.0, -1.0), center),
            **({} if key is None else {"observation_keypoint": key}),
            "format": "bundler",
        },
        colors=tracks["colors"],
        project=project,
        measured=tracks["xy"],
        unit=np.ones(len(registered)),
        notes=notes,
        data={"names": names},
        axes=_AXES,
    )


def _registered(
    path: Path, registered: NDArray[np.intp], count: int, tracks: dict[str, Any]
) -> tuple[NDArray[np.int32], list[str]]:
    """Return the index of each observation's image among the registered images, and notes."""
    if len(registered) == count:
        return tracks["image"], []
    place = np.full(count, -1, np.int32)
    place[registered] = np.arange(len(registered))
    image = place[tracks["image"]]
    refuse_row(
        image < 0,
        lambda first: (
            f"{shown(path)}: point {tracks['point'][first]}: expected views in registered images, "
            f"found one in camera {tracks['image'][first]}, whose focal length is 0"
        ),
    )
    missing = count - len(registered)
    return image, [
        f"{plural(missing, 'image')} of {count} {'is' if missing == 1 else 'are'} not registered."
    ]


def check(problem: Problem, path: Path) -> None:
    """Raise the error of :func:`write`; also if the list.txt there belongs to another model.

    Raises:
        InputError: a camera, a name or the folder cannot be written.
    """
    bal.radial_params(problem, "a Bundler file")
    check_names(problem, "list.txt")
    listed = path.parent / LIST
    if any(problem.image_names) and listed.exists() and not path.exists():
        raise InputError(
            f"{shown(path)}: expected a folder without {LIST}, the image names of another model, "
            f"found {shown(listed)}"
        )


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write a Bundler file; return sentences on information that is lost."""
    params = bal.radial_params(problem, "a Bundler file")
    place, names = _places(problem)
    rows = np.zeros((len(names), 15))
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rotations = FLIP[:, None] * rotation_matrices(unit)
    rows[place] = np.column_stack(
        [params[:, [0, 3, 4]], rotations.reshape(-1, 9), FLIP * pose[:, 4:]]
    )
    image = problem.observation_image
    xy = (problem.observation_xy - params[image, 1:3]) * np.array([1.0, -1.0])
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# Bundle file v0.3\n{len(names)} {problem.num_points}\n")
        for row in rows.tolist():
            file.write("%r %r %r\n" * 5 % tuple(row))
        write_tracks(
            file,
            ("%r %r %r\n%d %d %d\n%d", " %d %d %r %r", "\n"),
            np.column_stack([problem.points, colors_of(problem)]),
            np.column_stack([place[image], keys_of(problem), xy]),
            problem.observation_point,
        )
    return (
        *common_losses(problem, keeps=("names", "colors")),
        *moved_centers(problem),
    )


def write_beside(problem: Problem, path: Path) -> None:
    """Write list.txt into the folder of a Bundler file, if images have names."""
    _, names = _places(problem)
    if any(names):
        lines = "".join(f"{name or 'unnamed'}\n" for name in names)
        with atomic.replace_file(path.parent / LIST) as temporary:
            temporary.write_text(lines, "utf-8", errors="surrogateescape")


def moved_centers(problem: Problem) -> tuple[str, ...]:
    """Return a sentence if principal points are not the centres of the images."""
    params = bal.radial_params(problem)
    sizes = problem.camera_sizes[problem.image_camera]
    off = np.abs(params[:, 1:3] - sizes / 2).max(initial=0.0)
    if not off or not sizes.any():
        return ()
    return (
        f"Principal points, up to {off:.4g} px off the image centre, move to the centre: "
        "pixels are written relative to them.",
    )


def _places(problem: Problem) -> tuple[np.ndarray, list[str]]:
    """Return the position of each image in the file, and the names of all images of the file.

    Images of a Bundler file keep their positions, with those that are not registered between them.
    """
    source, ids = imported_source(problem), problem.image_ids
    if problem.format == "bundler" and source is not None:
        names = list(source.data["names"])
        if len(ids) and ids.min() >= 0 and ids.max() < len(names):
            return ids, names
    return np.arange(problem.num_images), list(problem.image_names)
