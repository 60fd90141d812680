"""A flight through a textured room, rendered: a mav0 folder with images, IMU samples and truth.

The rays of all pixels are intersected with the six walls of a box, and the walls' textures are
sampled there. So every camera model renders exactly, by its inverse alone. Samples are those of the
analytic motion: rates by central differences of the rotation, forces by the second derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from bundle.model.lenses.exact_image import pixel_rays

Array = np.ndarray[Any, Any]

START = 1_403_715_273_262_142_976  # ns
ROOM = np.array([4.0, 3.5, 2.5])  # m, half the size
TEXELS = 110  # per metre
RAMP = 2.0  # s, from rest to full speed
GRAVITY = np.array([0.0, 0.0, -9.81])
# IMU: x right, y forward, z up at rest; the camera looks along y, its y axis points down
TURN = Rotation.from_euler("xyz", [1.2, -0.8, 0.5], degrees=True).as_matrix()
CAMERA_FROM_IMU = np.eye(4)
CAMERA_FROM_IMU[:3, :3] = TURN @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
CAMERA_FROM_IMU[:3, 3] = [0.03, -0.02, 0.05]
PINHOLE = ("OPENCV", (460.0, 458.0, 322.0, 243.0, -0.28, 0.07, 2e-4, -1e-4))
FISHEYE = ("OPENCV_FISHEYE", (191.0, 190.9, 254.9, 256.8, 3.5e-3, 7e-4, -2e-3, 2e-4))
SMALL = {"lens": ("OPENCV", (230.0, 229.0, 161.0, 121.5, *PINHOLE[1][4:])), "size": (320, 240)}
SMALL_FISHEYE = {
    "lens": ("OPENCV_FISHEYE", (95.5, 95.4, 127.4, 128.4, *FISHEYE[1][4:])),
    "size": (256, 256),
}
NOISE = {
    "gyroscope_noise_density": 1.7e-4,
    "gyroscope_random_walk": 2e-5,
    "accelerometer_noise_density": 2e-3,
    "accelerometer_random_walk": 3e-3,
}


@dataclass(frozen=True)
class Flight:
    """Settings of a flight.

    Attributes:
        seed: of texture, motion and noise.
        duration: s.
        rate: images per second.
        lens: camera model and parameters.
        size: width and height of images.
        still: seconds at rest at the start.
        bare: images from and to which the walls lose most of their texture, as seconds.
        offset: seconds by which stamps of images are too early.
        speed: factor on the frequencies of the motion.
        pixel_noise: standard deviation of grey values.
        imu_rate: samples per second.
        gyro_bias, accel_bias: rad/s, m/s^2.
    """

    seed: int = 1
    duration: float = 10.0
    rate: float = 20.0
    lens: tuple[str, tuple[float, ...]] = PINHOLE
    size: tuple[int, int] = (640, 480)
    still: float = 0.0
    bare: tuple[float, float] = (0.0, 0.0)
    offset: float = 0.0
    speed: float = 1.0
    pixel_noise: float = 2.0
    imu_rate: int = 200
    gyro_bias: tuple[float, float, float] = (0.012, -0.02, 0.03)
    accel_bias: tuple[float, float, float] = (0.05, -0.04, 0.06)
    phases: Array = field(init=False)

    def __post_init__(self) -> None:
        phases = np.random.default_rng(self.seed).uniform(0, 2 * np.pi, (2, 3, 2))
        object.__setattr__(self, "phases", phases)

    def position(self, times: Array, derivative: int = 0) -> Array:
        """Return positions of the IMU (n, 3) or their derivatives by :func:`clock`."""
        return _waves(times, self.phases[0], [[1.1, 0.25], [0.9, 0.25], [0.5, 0.15]], derivative)

    def clock(self, times: Array) -> Array:
        """Return the time along the motion, which begins smoothly after the rest."""
        t = np.maximum(times - self.still, 0.0)
        if not self.still:
            return self.speed * times
        x = np.minimum(t / RAMP, 1.0)  # the speed grows by 3 x^2 - 2 x^3 to 1
        return self.speed * np.where(t < RAMP, RAMP * (x**3 - x**4 / 2), t - RAMP / 2)

    def states(self, times: Array) -> tuple[Array, Rotation]:
        """Return positions (n, 3) and rotations world_from_imu."""
        s = self.clock(times)
        angles = _waves(s, self.phases[1], [[0.25, 0.08], [0.25, 0.08], [0.9, 0.15]], 0)
        return self.position(s), Rotation.from_euler("ZYX", angles[:, ::-1])

    def samples(self, times: Array) -> tuple[Array, Array]:
        """Return angular rates and specific forces in the IMU's frame."""
        step = 1e-3
        (before, r0), (now, r1), (after, r2) = (self.states(times + d) for d in (-step, 0, step))
        gyro = (r0.inv() * r2).as_rotvec() / (2 * step)
        return gyro, r1.inv().apply((after - 2 * now + before) / step**2 - GRAVITY)


def _waves(s: Array, phases: Array, sizes: Any, derivative: int) -> Array:
    rates = np.array([[0.9, 2.1], [1.1, 2.4], [1.3, 1.9]])
    turned = s[:, None, None] * rates + phases + derivative * np.pi / 2
    return (np.array(sizes) * rates**derivative * np.sin(turned)).sum(axis=2)


def texture(seed: int) -> Array:
    """Return the six walls in one picture, one below the other: smooth noise, patches, edges."""
    rng = np.random.default_rng(seed)
    height, width = 6 * 8 * TEXELS, 8 * TEXELS
    picture = np.full((height, width), 110.0, np.float32)
    for size in (64, 24, 10):
        noise = rng.normal(0, 1, (height // size + 2, width // size + 2)).astype(np.float32)
        picture += 14 * cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(5000):
        x, y = int(rng.integers(width)), int(rng.integers(height))
        w, h = rng.integers(6, 60, 2).tolist()
        shade = float(rng.uniform(20, 235))
        cv2.rectangle(picture, (x, y), (x + w, y + h), shade, -1)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 0.8), 0, 255)


class Renderer:
    """Renderer of one camera in one room."""

    def __init__(self, flight: Flight) -> None:
        width, height = flight.size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
        model, params = flight.lens
        rays, seen = pixel_rays(model, np.array(params), grid.astype(float))
        self.rays = np.where(seen[:, None], rays, 0.0).astype(np.float32)
        self.seen, self.size = seen, (height, width)
        self.walls = texture(flight.seed)

    def image(self, position: Array, turn: Array, contrast: float = 1.0) -> Array:
        """Return the image of a camera (float32) at a pose world_from_camera."""
        rays = self.rays @ turn.T.astype(np.float32)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = (np.sign(rays) * ROOM - position).astype(np.float32) / rays
        steps[~np.isfinite(steps)] = np.inf
        axis = np.argmin(steps, axis=1)
        rows = np.arange(len(rays))
        depth = np.where(self.seen, steps[rows, axis], 0.0)
        hit = position.astype(np.float32) + depth[:, None] * rays
        wall = 2 * axis + (rays[rows, axis] > 0)
        u = hit[rows, (axis + 1) % 3] + 4.0
        v = hit[rows, (axis + 2) % 3] + 4.0 + 8.0 * wall
        at = [(TEXELS * each).reshape(self.size).astype(np.float32) for each in (u, v)]
        image = cv2.remap(self.walls, at[0], at[1], cv2.INTER_LINEAR)
        image = np.where(self.seen.reshape(self.size), image, 0.0)
        return 110 + contrast * (image - 110)


def render(flight: Flight, folder: Path) -> Path:
    """Write mav0 with images, samples, calibrations and truth; return its path."""
    rng = np.random.default_rng(flight.seed + 100)
    mav = folder / "mav0"
    for name in ("cam0/data", "imu0", "state_groundtruth_estimate0"):
        (mav / name).mkdir(parents=True)
    imu_times = np.arange(round(flight.imu_rate * flight.duration) + 1) / flight.imu_rate
    gyro, accel = flight.samples(imu_times)
    root = np.sqrt(flight.imu_rate)
    gyro = gyro + np.array(flight.gyro_bias) + rng.normal(0, root * 1.7e-4, gyro.shape)
    accel = accel + np.array(flight.accel_bias) + rng.normal(0, root * 2e-3, accel.shape)
    stamps = START + np.round(1e9 * imu_times).astype(np.int64)
    write_rows(mav / "imu0/data.csv", "#timestamp [ns],w x,w y,w z,a x,a y,a z", stamps,
               np.hstack([gyro, accel]))  # fmt: skip
    times = np.arange(round(flight.rate * (flight.duration - 0.1))) / flight.rate + 0.05
    positions, turns = flight.states(times)
    truth = np.hstack([positions, turns.as_quat()[:, [3, 0, 1, 2]]])
    image_stamps = START + np.round(1e9 * times).astype(np.int64)
    write_rows(mav / "state_groundtruth_estimate0/data.csv", "#timestamp, p, q w x y z",
               image_stamps, np.hstack([truth, np.zeros((len(truth), 9))]))  # fmt: skip
    renderer = Renderer(flight)
    imu_from_camera = np.linalg.inv(CAMERA_FROM_IMU)
    named = image_stamps - round(1e9 * flight.offset)
    for time, stamp, position, turn in zip(times, named, positions, turns, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn.as_matrix(), position
        pose = pose @ imu_from_camera
        contrast = 0.08 if flight.bare[0] <= time < flight.bare[1] else 1.0
        image = renderer.image(pose[:3, 3], pose[:3, :3], contrast)
        image = image + rng.normal(0, flight.pixel_noise, image.shape)
        cv2.imwrite(str(mav / f"cam0/data/{stamp}.png"), np.clip(image, 0, 255).astype(np.uint8))
    lines = ["#timestamp [ns],filename", *(f"{stamp},{stamp}.png" for stamp in named)]
    (mav / "cam0/data.csv").write_text("\r\n".join(lines) + "\r\n")
    write_calibration(flight, mav)
    return mav


def write_rows(path: Path, head: str, stamps: Array, values: Array) -> None:
    rows = zip(stamps.tolist(), values.tolist(), strict=True)
    lines = [",".join(map(repr, [stamp, *row])) for stamp, row in rows]
    path.write_text("\n".join([head, *lines, ""]))


def write_calibration(flight: Flight, mav: Path) -> None:
    model, params = flight.lens
    camera = {
        "sensor_type": "camera",
        "T_BS": _matrix(np.linalg.inv(CAMERA_FROM_IMU)),
        "rate_hz": flight.rate,
        "resolution": list(flight.size),
        "camera_model": "pinhole",
        "intrinsics": list(params[:4]),
        "distortion_model": "radial-tangential" if model == "OPENCV" else "equidistant",
        "distortion_coefficients": list(params[4:]),
    }
    if flight.offset:
        camera["timeshift_cam_imu"] = flight.offset
    imu = {"sensor_type": "imu", "T_BS": _matrix(np.eye(4)), "rate_hz": flight.imu_rate, **NOISE}
    (mav / "cam0/sensor.yaml").write_text("# comment\n" + yaml.safe_dump(camera))
    (mav / "imu0/sensor.yaml").write_text("# comment\n" + yaml.safe_dump(imu))


def _matrix(values: Array) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": np.asarray(values).ravel().tolist()}
