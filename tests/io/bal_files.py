"""Small BAL files for tests, and the BAL projection as its authors write it down."""

import gzip
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import bundle

Array = NDArray[np.float64]


def make_bal(
    seed: int, num_cameras: int = 4, num_points: int = 9, max_angle: float = 3.0
) -> tuple[list[tuple[int, int, float, float]], Array, Array]:
    """Return seeded observations, cameras (n, 9) and points (m, 3) in BAL's conventions."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(num_cameras, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    cameras = np.empty((num_cameras, 9))
    cameras[:, :3] = axes * rng.uniform(0.0, max_angle, (num_cameras, 1))
    cameras[:, 3:6] = rng.normal(size=(num_cameras, 3))
    cameras[:, 6] = rng.uniform(200.0, 2000.0, num_cameras)
    cameras[:, 7:] = rng.normal(size=(num_cameras, 2)) * (0.1, 0.01)
    points = rng.normal(size=(num_points, 3)) * 5.0
    observations = [
        (camera, point, *(rng.normal(size=2) * 300.0).tolist())
        for point in range(num_points)
        for camera in range(num_cameras)
        if (camera + point) % 3
    ]
    return observations, cameras, points


def bal_text(
    observations: list[tuple[int, int, float, float]], cameras: Array, points: Array
) -> bytes:
    lines = [f"{len(cameras)} {len(points)} {len(observations)}"]
    lines += [f"{camera} {point}     {x!r} {y!r}" for camera, point, x, y in observations]
    lines += [repr(float(value)) for value in [*cameras.flat, *points.flat]]
    return ("\n".join(lines) + "\n").encode()


def parse_bal(text: bytes) -> tuple[list[int], Array, Array, Array]:
    """Return header, observations (k, 4), cameras (n, 9) and points (m, 3) of a BAL text."""
    numbers = [float(token) for token in text.split()]
    n, m, k = (int(number) for number in numbers[:3])
    body = np.array(numbers[3:])
    assert len(body) == 4 * k + 9 * n + 3 * m
    observations, cameras, points = np.split(body, [4 * k, 4 * k + 9 * n])
    return [n, m, k], observations.reshape(-1, 4), cameras.reshape(-1, 9), points.reshape(-1, 3)


def project_bal(cameras: Array, points: Array) -> Array:
    """P = R X + t; p = -P / P.z; p' = f (1 + k1 |p|^2 + k2 |p|^4) p. Row by row, in pixels."""
    in_camera = Rotation.from_rotvec(cameras[:, :3]).apply(points) + cameras[:, 3:6]
    p = -in_camera[:, :2] / in_camera[:, 2:]
    radius2 = (p**2).sum(axis=1)
    f, k1, k2 = cameras[:, 6], cameras[:, 7], cameras[:, 8]
    return (f * (1 + k1 * radius2 + k2 * radius2**2))[:, None] * p


def load_bytes(folder: Path, data: bytes, name: str = "problem.txt") -> bundle.Problem:
    path = folder / name
    path.write_bytes(data)
    return bundle.load(path)


def colmap_residuals(problem: bundle.Problem) -> Array:
    """Projection minus measurement by COLMAP's RADIAL model, (num_observations, 2) pixels."""
    poses = problem.cam_from_world[problem.observation_image]
    points = problem.points[problem.observation_point]
    in_camera = Rotation.from_quat(poses[:, :4]).apply(points) + poses[:, 4:]
    p = in_camera[:, :2] / in_camera[:, 2:]
    params = problem.camera_params[problem.image_camera[problem.observation_image]]
    f, cx, cy, k1, k2 = params.T
    radius2 = (p**2).sum(axis=1)
    scale = f * (1 + k1 * radius2 + k2 * radius2**2)
    return scale[:, None] * p + np.stack([cx, cy], axis=1) - problem.observation_xy


def gzip_bytes(data: bytes) -> bytes:
    return gzip.compress(data, mtime=0)
