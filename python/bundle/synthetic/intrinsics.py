"""Intrinsics: true camera parameters of a scene, with realistic distortion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.synthetic.scene import Images

FOCAL_PARAMS = ("f", "fx", "fy")
RADIAL_PARAMS = ("k", "k1", "k2")
TANGENTIAL_PARAMS = ("p1", "p2")


@dataclass(frozen=True)
class Intrinsics:
    """Cameras of a scene, which all have the same model.

    Attributes:
        model: COLMAP's name of the model.
        names: parameter names, in COLMAP's order.
        params: (num_cameras, num_params) parameters.
        sizes: (num_cameras, 2) width and height in pixels.
        image_camera: (num_images,) camera index of each image.
    """

    model: str
    names: tuple[str, ...]
    params: NDArray[np.float64]
    sizes: NDArray[np.int64]
    image_camera: NDArray[np.int32]

    def of_image(self, image: int) -> NDArray[np.float64]:
        """Return the parameters (num_params,) of the camera of an image."""
        row: NDArray[np.float64] = self.params[self.image_camera[image]]
        return row

    def problem_of(self, cam_from_world: NDArray[np.float64], names: tuple[str, ...]) -> Problem:
        """Return a problem of the images with these poses (n, 7) and names, without points."""
        num_cameras = len(self.params)
        return Problem(
            cam_from_world=cam_from_world,
            image_ids=np.arange(1, len(names) + 1),
            image_names=names,
            image_camera=self.image_camera,
            camera_ids=np.arange(1, num_cameras + 1),
            camera_models=(self.model,) * num_cameras,
            camera_params=self.params,
            camera_sizes=self.sizes,
            points=np.zeros((0, 3)),
            observation_image=np.zeros(0, np.int32),
            observation_point=np.zeros(0, np.int32),
            observation_xy=np.zeros((0, 2)),
        )

    def columns(self, names: tuple[str, ...]) -> list[int]:
        """Return the columns of ``params`` that contain any of the named parameters."""
        return [column for column, name in enumerate(self.names) if name in names]


def draw_intrinsics(
    rng: np.random.Generator, images: Images, model: str, *, shared: bool
) -> Intrinsics:
    """Draw one camera for all images (of equal size and focal length), or one for each image.

    The principal point is the centre of the image. Distortion is as in ordinary lenses: mild barrel
    distortion, smaller for longer focal lengths, and monotonic well beyond the corners of the
    image.
    """
    count = 1 if shared else len(images.focal)
    sizes, focal = images.sizes[:count], images.focal[:count]
    pixels = focal * sizes.max(axis=1)
    # A coefficient multiplies the squared field angle, so it is scaled by the corner's.
    corner = 0.25 * (sizes**2).sum(axis=1) / pixels**2
    k1 = rng.uniform(-0.05, -0.01, count) / np.maximum(corner, 0.3)
    k2 = rng.uniform(0.0, 0.01, count) / np.maximum(corner, 0.3) ** 2
    values = {
        "f": pixels,
        "fx": pixels,
        "fy": pixels * rng.uniform(0.995, 1.005, count),
        "cx": 0.5 * sizes[:, 0],
        "cy": 0.5 * sizes[:, 1],
        "k": k1,
        "k1": k1,
        "k2": k2,
        "p1": rng.uniform(-1e-3, 1e-3, count),
        "p2": rng.uniform(-1e-3, 1e-3, count),
    }
    names = camera_models()[model]
    image_camera = np.zeros(len(images.focal)) if shared else np.arange(count)
    return Intrinsics(
        model=model,
        names=names,
        params=np.stack([values[name] for name in names], axis=1),
        sizes=sizes,
        image_camera=image_camera.astype(np.int32),
    )
