"""Reconstructions of sequences in a frame and unit of their own, as a mapper makes them."""

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.similarity import Similarity, moved
from bundle.inertial.vio.trajectory_comparison import states_at

CENTER = np.array([376.0, 240.0])


def world_from_imu(problem, camera_from_imu):
    """(n, 7) poses of the IMU."""
    pose, arm = problem.cam_from_world, np.asarray(camera_from_imu)
    inverse = Rotation.from_quat(pose[:, :4]).inv()
    turned = (inverse * Rotation.from_quat(arm[:4])).as_quat()
    return np.hstack([turned, inverse.apply(arm[4:] - pose[:, 4:])])


def model_of(sequence, truth, step, *, scale=3.7, seed=5, noise=1.0):
    """A reconstruction of every `step`-th image, near the truth, and its stamps."""
    rng = np.random.default_rng(0)
    arm = np.array(sequence.calibration.camera_from_imu)
    stamps = np.unique(sequence.image_timestamps_ns)
    first = max(truth.timestamps_ns[0], sequence.imu_timestamps_ns[0])
    last = min(truth.timestamps_ns[-1], sequence.imu_timestamps_ns[-1])
    stamps = stamps[(stamps >= first) & (stamps <= last)][::step]
    states = states_at(truth, stamps)
    turned = Rotation.from_quat(states[:, :4])
    turned *= Rotation.from_rotvec(0.02 * noise * rng.normal(size=(len(stamps), 3)))
    places = states[:, 4:7] + 0.05 * noise * rng.normal(size=(len(stamps), 3))
    rotation = Rotation.from_quat(arm[:4]) * turned.inv()
    shift = arm[4:] - rotation.apply(places)
    image = np.searchsorted(stamps, sequence.image_timestamps_ns)
    seen = image < len(stamps)
    seen &= stamps[np.minimum(image, len(stamps) - 1)] == sequence.image_timestamps_ns
    image, track, xy = image[seen], sequence.track_ids[seen], sequence.normalized()[seen]
    _, point = np.unique(track, return_inverse=True)
    points, kept = np.zeros((point.max() + 1, 3)), np.zeros(point.max() + 1, bool)
    matrices = rotation.as_matrix()
    for k in range(len(points)):
        rows = np.flatnonzero(point == k)
        if len(rows) < 3:
            continue
        views = np.concatenate([matrices[image[rows]], shift[image[rows], :, None]], axis=2)
        lines = xy[rows, :, None] * views[:, 2:] - views[:, :2]
        found = np.linalg.svd(lines.reshape(-1, 4))[2][-1]
        place = found[:3] / found[3]
        depth = (views[:, 2, :3] @ place) + views[:, 2, 3]
        base = np.ptp(-np.einsum("nji,nj->ni", views[:, :, :3], views[:, :, 3]), axis=0)
        kept[k] = depth.min() > 0.2 and depth.max() < 50
        kept[k] &= np.linalg.norm(base) > 0.02 * np.median(depth)
        points[k] = place
    used = kept[point]
    focal = sequence.calibration.focal
    keypoint = np.zeros(int(used.sum()), int)
    for k in range(len(stamps)):
        rows = np.flatnonzero(image[used] == k)
        keypoint[rows] = np.arange(len(rows))
    problem = bundle.Problem(
        cam_from_world=np.hstack([rotation.as_quat(), shift]),
        image_ids=np.arange(1, len(stamps) + 1),
        image_names=[f"{stamp}.png" for stamp in stamps],
        image_camera=np.zeros(len(stamps), int),
        camera_ids=np.array([1]),
        camera_models=["PINHOLE"],
        camera_params=np.array([[focal, focal, *CENTER]]),
        camera_sizes=np.array([[752, 480]]),
        points=points[kept],
        point_ids=np.arange(1, kept.sum() + 1),
        observation_image=image[used],
        observation_point=(np.cumsum(kept) - 1)[point[used]],
        observation_xy=focal * xy[used] + CENTER,
        observation_keypoint=keypoint,
    )
    turn = Rotation.random(random_state=seed).as_matrix()
    return moved(problem, Similarity(1 / scale, turn, np.array([3.0, -7, 2]))), stamps
