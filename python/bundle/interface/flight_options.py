"""Options of a synthetic flight."""

from __future__ import annotations

import math

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option
from bundle.interface.scene_options import outlier_share_option, pixel_noise_option

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
    )
    duration: float = option(
        30.0, "--duration", "seconds, including the rest at the start", above=0.0, metavar="SECONDS"
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
    pixel_noise: float = pixel_noise_option()
    outlier_share: float = outlier_share_option()
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
        "standard deviation of the gyroscope's first bias, in rad/s",
        minimum=0.0,
        below=1.0,
        metavar="X",
    )
    accel_bias: float = option(
        0.05,
        "--accel-bias",
        "standard deviation of the accelerometer's first bias, in m/s^2",
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
