"""Options of synthetic scenes and flights.

Names, defaults and meanings are defined only here. The command line generates its flags from these
fields, and the JSON report lists them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option, same

SCENES = ("street", "orbit", "photo_collection", "drone_grid")
# Models for which ``synthetic.scene`` can draw realistic parameters.
CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
CAMERAS = ("auto", "shared", "individual")
MIN_OBSERVATIONS_PER_IMAGE = 20
MIN_TRACK_LENGTH = 2
USUAL_TRACK_LENGTH = 6.0


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class SceneOptions(Options):
    """Options of :func:`bundle.synthesize`.

    Choices are accepted in any case, with hyphens or underscores ("photo-collection").

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    scene: str = option(
        "street",
        "--scene",
        "street: a drive through a road network; orbit: rings of cameras around an object; "
        "photo-collection: clusters of very different cameras around landmarks; drone-grid: strips "
        "of a drone that looks down",
        choices=SCENES,
        use=3,
    )
    num_images: int = option(40, "--images", "number of images", minimum=2, metavar="N", use=4)
    num_points: int = option(3000, "--points", "number of points", minimum=20, metavar="N", use=5)
    mean_track_length: float = option(
        0.0,
        "--track-length",
        "mean number of observations per point, at least 2; 0: 6, or as many as the images of a "
        "small scene permit",
        minimum=0.0,
        metavar="X",
        use=6,
    )
    camera_model: str = option(
        "SIMPLE_RADIAL", "--camera-model", "COLMAP's camera model", choices=CAMERA_MODELS, use=7
    )
    cameras: str = option(
        "auto",
        "--cameras",
        "one camera for all images, or one camera per image; auto: individual for "
        "photo-collection, shared for other scenes",
        choices=CAMERAS,
        use=8,
    )
    image_size: tuple[int, int] = option(
        (1280, 960),
        "--image-size",
        "width and height in pixels; individual cameras of a photo-collection spread around it",
        minimum=64,
        metavar=("WIDTH", "HEIGHT"),
        use=9,
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
        "perturbation of the start's radial distortion coefficients: standard deviation; "
        "tangential coefficients get a tenth of it",
        minimum=0.0,
        below=1e6,
        metavar="X",
        only_with=("camera_model", ("SIMPLE_RADIAL", "RADIAL", "OPENCV")),
    )
    loop_closure: bool = option(
        True,
        "--loop-closure",
        "drive laps, which return to earlier positions, instead of one way",
        only_with=("scene", ("street",)),
    )
    num_rings: int = option(
        0,
        "--rings",
        "rings of cameras at different heights; 0: one per 40 images, at most 6",
        minimum=0,
        metavar="N",
        only_with=("scene", ("orbit",)),
    )
    rolling_shutter: float = option(
        0.0,
        "--rolling-shutter",
        "readout of a rolling shutter as a share of the frame time. The images are frames of a "
        "film: of a car (street), of a walk with a phone (orbit), or of a drone (drone-grid)",
        minimum=0.0,
        maximum=1.0,
        metavar="SHARE",
        only_with=("scene", ("street", "orbit", "drone_grid")),
        use=13,
    )
    gravity_sigma: float = option(
        0.0,
        "--gravity",
        "measure gravity in each image: standard deviation about each axis perpendicular to it, in "
        "degrees; 0: no measurements",
        minimum=0.0,
        below=180.0,
        metavar="DEGREES",
    )
    orientation_sigma: float = option(
        0.0,
        "--orientations",
        "measure the orientation of each image: standard deviation about each axis, in degrees; 0: "
        "no measurements",
        minimum=0.0,
        below=180.0,
        metavar="DEGREES",
    )
    seed: int = option(
        0,
        "--seed",
        ("seed of the random numbers; the same seed gives the same scene"),
        minimum=0,
        maximum=math.inf,
        metavar="N",
        use=12,
    )

    def _check(self, fields: Iterable[dataclasses.Field[Any]]) -> None:
        super()._check(fields)
        if 0 < self.mean_track_length < MIN_TRACK_LENGTH:
            raise InputError(
                f"mean_track_length: expected at least {MIN_TRACK_LENGTH}, or 0, "
                f"found {self.mean_track_length:g}"
            )
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

        if self.is_filmed and self.mean_track_length:
            raise InputError(
                "mean_track_length: expected 0 with a filmed scene, whose motion decides which "
                f"images observe a point, found {self.mean_track_length:g}"
            )

    @property
    def is_filmed(self) -> bool:
        """True if the images are frames of one smooth motion."""
        return self.rolling_shutter > 0 or self.scene == "drone_grid"

    @property
    def wanted_track_length(self) -> float:
        """Requested mean track length."""
        return self.mean_track_length or min(USUAL_TRACK_LENGTH, self.num_images)

    @property
    def has_shared_camera(self) -> bool:
        """True if all images share one camera."""
        if self.cameras == "auto":
            return self.scene != "photo_collection"
        return self.cameras == "shared"


MOTIONS = ("loop", "room", "motorway", "hover", "rotation_only")
SAMPLES = ("interval", "instant")
MOST_SAMPLES = 2e8


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class FlightOptions(Options):
    """Options of :func:`bundle.synthesize_flight`.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    motion: str = option(
        "loop",
        "--motion",
        "loop: laps in a room, looking ahead; room: to and fro in a room; motorway: some seconds "
        "of acceleration and lane changes, then constant velocity; hover: some seconds of room, "
        "then in one place; rotation-only: turns about the IMU",
        choices=MOTIONS,
        use=14,
    )
    duration: float = option(
        30.0,
        "--duration",
        "seconds, including the rest at the start",
        above=0.0,
        metavar="SECONDS",
        use=15,
    )
    rest: float = option(
        2.0, "--rest", "seconds at rest at the start", minimum=0.0, metavar="SECONDS"
    )
    imu_rate: float = option(
        200.0, "--imu-rate", "IMU samples per second", above=0.0, maximum=1e4, metavar="HZ"
    )
    camera_rate: float = option(
        20.0, "--camera-rate", "images per second", above=0.0, maximum=1e3, metavar="HZ"
    )
    num_tracks: int = option(
        60, "--tracks", "tracks per image, if enough points are in view", minimum=1, metavar="N"
    )
    track_length: float = option(
        60.0,
        "--mean-track",
        "mean number of images after which a track is lost, if its point stays in view",
        minimum=1.0,
        metavar="N",
    )
    pixel_noise: float = same(SceneOptions, "pixel_noise")
    outlier_share: float = same(SceneOptions, "outlier_share")
    imu_noise_scale: float = option(
        1.0,
        "--imu-noise",
        "noise densities and random walks of the IMU, as multiples of those of an ADIS16448 "
        "(EuRoC): 1.7e-4 rad/s and 2.0e-3 m/s^2 per sqrt(Hz)",
        minimum=0.0,
        below=1e6,
        metavar="X",
    )
    gyro_bias: float = option(
        0.02,
        "--gyro-bias",
        "standard deviation of the gyroscope's initial bias, in rad/s",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )
    accel_bias: float = option(
        0.05,
        "--accel-bias",
        "standard deviation of the accelerometer's initial bias, in m/s^2",
        minimum=0.0,
        below=5.0,
        metavar="X",
    )
    imu_samples: str = option(
        "interval",
        "--imu-samples",
        "interval: a sample is the mean up to the next sample, so that integration with zero-order "
        "hold is exact; instant: a sample is the rate and specific force at its stamp",
        choices=SAMPLES,
    )
    time_offset: float = option(
        0.0,
        "--time-offset",
        "seconds that must be added to the stamps of images",
        minimum=-1.0,
        maximum=1.0,
        metavar="SECONDS",
    )
    seed: int = option(
        0,
        "--seed",
        ("seed of the random numbers; the same seed gives the same flight"),
        minimum=0,
        maximum=math.inf,
        metavar="N",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, rate in (("imu_rate", self.imu_rate), ("camera_rate", self.camera_rate)):
            if not 1 <= self.duration * rate < MOST_SAMPLES:
                raise InputError(
                    f"duration: expected 1 to {MOST_SAMPLES:g} periods of {name}={rate:g}, "
                    f"found {self.duration:g} s"
                )
