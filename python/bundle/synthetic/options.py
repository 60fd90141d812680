"""What a synthetic scene can be asked for.

Names, defaults and meaning stand here once: the command line makes its flags from these fields and
the JSON report lists them.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from bundle.errors import InputError
from bundle.option_fields import checked, option

__all__ = ["SceneOptions"]

SCENES = ("street", "orbit", "photo_collection")
# Models that intrinsics.py can draw a believable lens of.
CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
CAMERAS = ("auto", "shared", "individual")
MIN_OBSERVATIONS_PER_IMAGE = 20


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Options of :func:`bundle.synthesize`.

    Choices are accepted in any case, with hyphens or underscores ("photo-collection").

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    scene: str = option(
        "street",
        "--scene",
        "street: a drive through a road network; orbit: rings of cameras around an object; "
        "photo-collection: clusters of very different cameras around landmarks",
        choices=SCENES,
    )
    num_images: int = option(40, "--images", "number of images", minimum=2, metavar="N")
    num_points: int = option(3000, "--points", "number of points", minimum=20, metavar="N")
    mean_track_length: float = option(
        6.0, "--track-length", "observations per point, on average", minimum=2.0, metavar="X"
    )
    camera_model: str = option(
        "SIMPLE_RADIAL", "--camera-model", "COLMAP's camera model", choices=CAMERA_MODELS
    )
    cameras: str = option(
        "auto",
        "--cameras",
        "one camera for all images, or one per image; auto: individual for photo-collection, "
        "shared for the others",
        choices=CAMERAS,
    )
    image_size: tuple[int, int] = option(
        (1280, 960),
        "--image-size",
        "width and height in pixels; individual cameras of a photo-collection spread around it",
        minimum=64,
        metavar=("WIDTH", "HEIGHT"),
    )
    pixel_noise: float = option(
        0.5,
        "--pixel-noise",
        "standard deviation of x and of y, in pixels",
        minimum=0.0,
        below=1e6,
        metavar="PIXELS",
    )
    outlier_share: float = option(
        0.0,
        "--outlier-share",
        "share of the observations replaced by uniformly random pixels",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )
    rotation_noise: float = option(
        0.5,
        "--rotation-noise",
        "perturbation of the start's rotations: standard deviation about each axis, in degrees",
        minimum=0.0,
        below=180.0,
        metavar="DEGREES",
    )
    translation_noise: float = option(
        0.005,
        "--translation-noise",
        "perturbation of the start's camera centres: standard deviation along each axis, relative "
        "to the scene's scale, which is the median distance of a point from its cameras",
        minimum=0.0,
        below=1e6,
        metavar="X",
    )
    point_noise: float = option(
        0.005,
        "--point-noise",
        "perturbation of the start's points, likewise relative to the scene's scale",
        minimum=0.0,
        below=1e6,
        metavar="X",
    )
    focal_noise: float = option(
        0.01,
        "--focal-noise",
        "perturbation of the start's focal lengths: relative standard deviation",
        minimum=0.0,
        below=0.5,
        metavar="X",
    )
    distortion_noise: float = option(
        0.005,
        "--distortion-noise",
        "perturbation of the start's radial distortion coefficients: standard deviation; a tenth "
        "of it for tangential ones",
        minimum=0.0,
        below=1e6,
        metavar="X",
    )
    loop_closure: bool = option(
        True,
        "--loop-closure",
        "street only: drive laps that come back to known places, not one way",
    )
    num_rings: int = option(
        0,
        "--rings",
        "orbit only: rings of cameras at different heights; 0: one per 40 images, at most 6",
        minimum=0,
        metavar="N",
    )
    seed: int = option(
        0, "--seed", "same seed, same scene", minimum=0, maximum=math.inf, metavar="N"
    )

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            object.__setattr__(self, field.name, checked(field, getattr(self, field.name)))
        if self.mean_track_length > self.num_images:
            raise InputError(
                f"mean_track_length: expected at most num_images = {self.num_images}, "
                f"found {self.mean_track_length:g}"
            )
        if self.num_rings > self.num_images:
            raise InputError(
                f"num_rings: expected at most num_images = {self.num_images}, "
                f"found {self.num_rings}"
            )

    @property
    def has_shared_camera(self) -> bool:
        """Whether all images share one camera."""
        if self.cameras == "auto":
            return self.scene != "photo_collection"
        return self.cameras == "shared"

    def replace(self, **changes: Any) -> SceneOptions:
        """Return a copy with some options changed."""
        return dataclasses.replace(self, **changes)

    def asdict(self) -> dict[str, Any]:
        """Return every option by name."""
        return dataclasses.asdict(self)
