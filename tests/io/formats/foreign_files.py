"""Files of other programs from small problems, written line by line from the formats' manuals.

Independent of the package's writers: plain loops, SciPy's rotations.
"""

import contextlib
import json
import sqlite3
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes


def small(model="RADIAL", **changes) -> bundle.Problem:
    """A problem whose principal points are the centres of the images, with keypoints."""
    problem = scenes.make_problem(
        **{"num_images": 4, "num_points": 30, "model": model, "track": 3, **changes}
    )
    keypoint = np.zeros(problem.num_observations, int)
    for image in range(problem.num_images):
        mine = problem.observation_image == image
        keypoint[mine] = np.arange(mine.sum())
    return problem.replace(observation_keypoint=keypoint)


def write_database(names, path: Path, size=(800, 600)) -> None:
    """The tables of COLMAP's database that have names and sizes, one camera for all images."""
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute(
            "CREATE TABLE cameras (camera_id INTEGER PRIMARY KEY, model INTEGER, width INTEGER, "
            "height INTEGER, params BLOB, prior_focal_length INTEGER)"
        )
        database.execute(
            "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER)"
        )
        database.execute("INSERT INTO cameras VALUES (3, 2, ?, ?, NULL, 0)", size)
        rows = [(k + 1, name, 3) for k, name in enumerate(names)]
        database.executemany("INSERT INTO images VALUES (?, ?, ?)", rows)


def matrices(problem):
    return Rotation.from_quat(problem.cam_from_world[:, :4]).as_matrix()


def views(problem, point):
    return np.flatnonzero(problem.observation_point == point)


def write_bundler(problem, path: Path, *, unregistered=(), names=None, forward=False) -> None:
    """`unregistered`: positions in the file of additional images without a pose.

    `forward`: axes that are not Bundler's: x right, y down, z forward.
    """
    flip = np.diag([1.0, 1, 1] if forward else [1.0, -1, -1])
    lines, place = ["# Bundle file v0.3"], []
    count = problem.num_images + len(unregistered)
    lines.append(f"{count} {problem.num_points}")
    rows = iter(range(problem.num_images))
    for position in range(count):
        if position in unregistered:
            lines += ["0 0 0"] * 5
            continue
        image = next(rows)
        place.append(position)
        f, _, _, k1, k2 = problem.camera_params[problem.image_camera[image]].tolist()
        lines.append(f"{f!r} {k1!r} {k2!r}")
        lines += [" ".join(map(repr, row)) for row in (flip @ matrices(problem)[image]).tolist()]
        lines.append(" ".join(map(repr, (flip @ problem.cam_from_world[image, 4:]).tolist())))
    for point in range(problem.num_points):
        lines.append(" ".join(map(repr, problem.points[point].tolist())))
        lines.append(f"{point % 256} {(7 * point) % 256} 9")
        seen = []
        for row in views(problem, point):
            image = problem.observation_image[row]
            camera = problem.image_camera[image]
            x, y = (problem.observation_xy[row] - problem.camera_params[camera, 1:3]).tolist()
            y = y if forward else -y
            seen.append(f"{place[image]} {problem.observation_keypoint[row]} {x!r} {y!r}")
        lines.append(" ".join([str(len(seen)), *seen]))
    path.write_text("\n".join(lines) + "\n")
    if names is not None:
        (path.parent / "list.txt").write_text("".join(f"{name} 0 800.5\n" for name in names))


def write_metashape(problem, folder: Path) -> None:
    """Bundler files as Metashape writes them: unregistered images, and paths of another machine.

    Blocks.exportCameras(..., format=CamerasFormatBundler, save_points=True, bundler_save_list=True)
    """
    write_bundler(problem, folder / "cameras.out", unregistered=(1,))
    names = [f"D:/survey one/DJI_{k:04}.JPG" for k in range(problem.num_images + 1)]
    (folder / "list.txt").write_text("".join(f"{name}\r\n" for name in names))


def write_realitycapture(problem, folder: Path) -> None:
    """Bundler files as RealityCapture writes them, in both directions of z."""
    write_bundler(problem, folder / "negative_z.out")
    write_bundler(problem, folder / "positive_z.out", forward=True)
    (folder / "images.imagelist").write_text("".join(f"{name}\n" for name in problem.image_names))


def write_nvm(
    problem, path: Path, distortion=0.0, after="0\n", *, first="NVM_V3 ", r9t=False
) -> None:
    """`r9t`: the variant R9T, which has R and t."""
    lines = ["NVM_V3_R9T" if r9t else first, "", str(problem.num_images)]
    rotations, centers = matrices(problem), problem.projection_centers
    for image in range(problem.num_images):
        x, y, z, w = Rotation.from_matrix(rotations[image]).as_quat().tolist()
        numbers = (problem.camera_params[problem.image_camera[image], 0], w, x, y, z)
        if r9t:
            numbers = (numbers[0], *rotations[image].ravel(), *problem.cam_from_world[image, 4:])
        numbers += (*(() if r9t else centers[image]), distortion, 0)
        name = problem.image_names[image].replace(" ", '"')
        lines.append(f"{name}\t" + " ".join(str(float(n)) for n in numbers))
    lines += ["", str(problem.num_points)]
    for point in range(problem.num_points):
        seen = []
        for row in views(problem, point):
            image = problem.observation_image[row]
            camera = problem.image_camera[image]
            x, y = (problem.observation_xy[row] - problem.camera_params[camera, 1:3]).tolist()
            seen.append(f"{image} {problem.observation_keypoint[row]} {x!r} {y!r}")
        xyz = " ".join(map(repr, problem.points[point].tolist()))
        lines.append(f"{xyz} {point % 256} 8 9 {len(seen)} " + " ".join(seen))
    path.write_text("\n".join(lines) + "\n\n" + after)


def sfm_camera(problem, camera):
    """The camera in OpenSfM's JSON."""
    model, p = problem.camera_models[camera], problem.camera_params[camera].tolist()
    width, height = problem.camera_sizes[camera].tolist()
    size = max(width, height)
    found = {"width": width, "height": height}
    if model == "EQUIRECTANGULAR":
        return found | {"projection_type": "spherical"}
    two = {"focal_x": p[0] / size, "focal_y": p[1] / size}
    two |= {"c_x": (p[2] - width / 2) / size, "c_y": (p[3] - height / 2) / size}
    if model in ("RADIAL", "RADIAL_FISHEYE"):
        kind = "fisheye" if "FISHEYE" in model else "perspective"
        return found | {"projection_type": kind, "focal": p[0] / size, "k1": p[3], "k2": p[4]}
    k = dict(zip(("k1", "k2", "k3", "k4"), p[4:8], strict=True))
    if model == "OPENCV_FISHEYE":
        return found | two | k | {"projection_type": "fisheye_opencv"}
    brown = {"k1": p[4], "k2": p[5], "p1": p[6], "p2": p[7], "k3": p[8] if len(p) > 8 else 0.0}
    return found | two | brown | {"projection_type": "brown"}


def write_opensfm(problem, folder: Path, version=2, **changes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    shots = {}
    for image in range(problem.num_images):
        pose = problem.cam_from_world[image]
        shots[problem.image_names[image]] = {
            "rotation": Rotation.from_quat(pose[:4]).as_rotvec().tolist(),
            "translation": pose[4:].tolist(),
            "camera": f"camera {problem.image_camera[image]}",
            "gps_position": [float(image), 2.0, 3.0],
            "gps_dop": 5.0,
        }
    reconstruction = {
        "cameras": {f"camera {c}": sfm_camera(problem, c) for c in range(problem.num_cameras)},
        "shots": shots,
        "points": {
            str(problem.point_ids[point]): {
                "color": [float(point % 256), 8.0, 9.0],
                "coordinates": problem.points[point].tolist(),
            }
            for point in range(problem.num_points)
        },
        **changes,
    }
    (folder / "reconstruction.json").write_text(json.dumps([reconstruction], indent=4))
    lines = [] if version == 0 else [f"OPENSFM_TRACKS_VERSION_v{version}"]
    for row in range(problem.num_observations):
        image = problem.observation_image[row]
        width, height = problem.camera_sizes[problem.image_camera[image]].tolist()
        x, y = problem.observation_xy[row].tolist()
        size = max(width, height)
        words = [problem.image_names[image], problem.point_ids[problem.observation_point[row]]]
        words += [
            problem.observation_keypoint[row],
            (x - width / 2) / size,
            (y - height / 2) / size,
        ]
        words += [] if version == 0 else [0.004]
        words += [10, 20, 30] + ([-1, -1] if version == 2 else [])
        lines.append("\t".join(map(str, words)))
    lines.append("\t".join(["gone.jpg", "7", "1", "0.1", "0.2"] + ["1"] * (3, 4, 6)[version]))
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")


MVG = {
    "SIMPLE_PINHOLE": ("pinhole", None),
    "SIMPLE_RADIAL": ("pinhole_radial_k1", "disto_k1"),
    "RADIAL": ("pinhole_radial_k3", "disto_k3"),
    "OPENCV": ("pinhole_brown_t2", "disto_t2"),
    "OPENCV_FISHEYE": ("fisheye", "fisheye"),
}


def write_openmvg(problem, path: Path, *, nested=False, without_pose=()) -> None:
    seen_kinds, intrinsics = {}, []
    for camera in range(problem.num_cameras):
        model, p = problem.camera_models[camera], problem.camera_params[camera].tolist()
        kind, member = MVG[model]
        two = len(bundle.camera_models()[model]) - 1 if "OPENCV" in model else 0
        extras = p[4:] if two else p[3:]
        if model == "RADIAL":
            extras = [*extras, 0.0]
        if model == "OPENCV":
            extras = [extras[0], extras[1], 0.0, extras[2], extras[3]]
        base = {
            "width": int(problem.camera_sizes[camera, 0]),
            "height": int(problem.camera_sizes[camera, 1]),
            "focal_length": p[0],
            "principal_point": p[2:4] if two else p[1:3],
        }
        data = {"value0": base} if nested else base
        value = {"ptr_wrapper": {"id": 2**31 + camera, "data": data}}
        if member:
            data[member] = extras
        if kind in seen_kinds:
            value["polymorphic_id"] = seen_kinds[kind]
        else:
            seen_kinds[kind] = len(seen_kinds) + 1
            value["polymorphic_id"] = 2**31 + seen_kinds[kind]
            value["polymorphic_name"] = kind
        intrinsics.append({"key": camera, "value": value})
    views_, extrinsics = [], []
    for image in range(problem.num_images):
        data = {
            "local_path": "",
            "filename": problem.image_names[image],
            "width": 800,
            "height": 600,
            "id_view": image,
            "id_intrinsic": int(problem.image_camera[image]),
            "id_pose": image,
        }
        wrapped = {"polymorphic_id": 2**30, "ptr_wrapper": {"id": 2**31 + 50 + image, "data": data}}
        views_.append({"key": image, "value": wrapped})
        if image in without_pose:
            continue
        pose = {
            "rotation": matrices(problem)[image].tolist(),
            "center": problem.projection_centers[image].tolist(),
        }
        extrinsics.append({"key": image, "value": pose})
    structure = []
    for point in range(problem.num_points):
        observations = [
            {
                "key": int(problem.observation_image[row]),
                "value": {
                    "id_feat": int(problem.observation_keypoint[row]),
                    "x": problem.observation_xy[row].tolist(),
                },
            }
            for row in views(problem, point)
        ]
        value = {"X": problem.points[point].tolist(), "observations": observations}
        structure.append({"key": int(problem.point_ids[point]), "value": value})
    scene = {
        "sfm_data_version": "0.3",
        "root_path": "/photos",
        "views": views_,
        "intrinsics": intrinsics,
        "extrinsics": extrinsics,
        "structure": structure,
        "control_points": [],
    }
    path.write_text(json.dumps(scene, indent=4))
