"""Small seeded problems with rigs of several sensors, projected by formulas of their own."""

import numpy as np
from scipy.spatial.transform import Rotation

from bundle import Problem
from tests.formulas import PARAMS
from tests.scenes import project

STEREO = ((0.01, 0.02, -0.01, -0.5, 0.02, 0.01),)
"""Rotation vector and translation of one sensor beside the reference sensor."""
FIVE = tuple((0.02 * k, -0.3 * k, 0.01, 0.2 * k, 0.1, -0.05 * k) for k in (-2, -1, 1, 2))


def pose_rows(rotations, translations):
    return np.hstack([np.atleast_2d(rotations.as_quat()), np.atleast_2d(translations)])


def rig_problem(
    *,
    num_frames=4,
    rigs=(STEREO,),
    num_alone=0,
    num_points=30,
    model="PINHOLE",
    seed=0,
    noise=0.5,
    perturbation=1e-2,
    missing=(),
    first_ids=(1, 1, 1, 1),
    **changes,
):
    """Rigs on arcs around a cloud that every image sees; images alone on the arc after them.

    Args:
        rigs: of each rig its arms, as STEREO has them; cameras are the rigs' own.
        num_alone: number of images without a rig, each with a camera of its own.
        missing: (rig, frame, sensor) of images that are not there, the reference sensor being 0.
        first_ids: of rigs, frames, images and cameras.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (num_points, 3))
    count = num_frames * len(rigs) + num_alone
    angles = np.linspace(-0.6, 0.6, count)
    rotations = Rotation.from_rotvec(np.stack([0.1 * angles, angles, 0.05 * angles], 1))
    translations = np.stack([0.1 * angles, -0.05 * angles, 4 + 0.3 * angles], 1)
    turn = Rotation.from_rotvec(perturbation * rng.standard_normal((count, 3)))
    shift = perturbation * rng.standard_normal((count, 3))
    first_rig, first_frame, first_image, first_camera = first_ids

    image_camera, image_frame, image_sensor, exact, start = [], [], [], [], []
    arms, rig_ids, camera_ids, sensor_row, camera = [], [], [], {}, 0
    for r, rig in enumerate(rigs):
        for s, arm in enumerate(rig, 1):
            sensor_row[r, s] = len(arms)
            arms.append(pose_rows(Rotation.from_rotvec(arm[:3]), np.array(arm[3:]))[0])
            rig_ids.append(first_rig + r)
            camera_ids.append(first_camera + camera + s)
        for f in range(num_frames):
            pose = r * num_frames + f
            for s in range(len(rig) + 1):
                if (r, f, s) in missing:
                    continue
                image_camera.append(camera + s)
                image_frame.append(pose)
                image_sensor.append(sensor_row.get((r, s), -1))
                for rows, turned, moved in (
                    (exact, rotations[pose], translations[pose]),
                    (start, turn[pose] * rotations[pose], translations[pose] + shift[pose]),
                ):
                    if s:
                        on_rig = Rotation.from_quat(arms[sensor_row[r, s]][:4])
                        moved = on_rig.apply(moved) + arms[sensor_row[r, s]][4:]
                        turned = on_rig * turned
                    rows.append(pose_rows(turned, moved)[0])
        camera += len(rig) + 1
    for k in range(num_alone):
        pose = num_frames * len(rigs) + k
        image_camera.append(camera)
        image_frame.append(-1)
        image_sensor.append(-1)
        exact.append(pose_rows(rotations[pose], translations[pose])[0])
        start.append(pose_rows(turn[pose] * rotations[pose], translations[pose] + shift[pose])[0])
        camera += 1

    params = np.tile(PARAMS[model], (camera, 1))
    params[:, 0] += np.arange(camera)
    num_images = len(exact)
    image = np.repeat(np.arange(num_images), num_points)
    point = np.tile(np.arange(num_points), num_images)
    xy = np.vstack(
        [
            project(
                model,
                params[image_camera[i]],
                Rotation.from_quat(exact[i][:4]).apply(points) + exact[i][4:],
            )
            for i in range(num_images)
        ]
    )
    xy += noise * rng.standard_normal(xy.shape)
    order = np.lexsort((image, point))
    framed = num_frames * len(rigs)
    frames = (turn * rotations)[:framed]
    arrays = {
        "cam_from_world": np.array(start),
        "image_ids": first_image + np.arange(num_images),
        "image_names": [f"image{i}.jpg" for i in range(num_images)],
        "image_camera": image_camera,
        "camera_ids": first_camera + np.arange(camera),
        "camera_models": [model] * camera,
        "camera_params": params,
        "camera_sizes": np.tile([800, 600], (camera, 1)),
        "points": points + perturbation * rng.standard_normal(points.shape),
        "point_ids": np.arange(1, num_points + 1),
        "observation_image": image[order],
        "observation_point": point[order],
        "observation_xy": xy[order],
        "rig_from_world": pose_rows(frames, (translations + shift)[:framed]),
        "frame_ids": first_frame + np.arange(framed),
        "frame_rig_ids": np.repeat(first_rig + np.arange(len(rigs)), num_frames),
        "image_frame": image_frame,
        "image_sensor": image_sensor,
        "sensor_from_rig": np.array(arms).reshape(-1, 7),
        "sensor_rig_ids": rig_ids,
        "sensor_camera_ids": camera_ids,
    }
    return Problem(**{**arrays, **changes})
