"""Options of a sliding window."""

from __future__ import annotations

from dataclasses import dataclass

from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option

__all__ = ["WindowOptions"]


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class WindowOptions(Options):
    """Options of :class:`bundle.SlidingWindow`.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    window: int = option(
        10, "--window", "keyframes in the window, beside the newest frame", minimum=2, metavar="N"
    )
    marginalize: str = option(
        "marginalize",
        "--marginalize",
        "what becomes of the oldest keyframe: marginalize leaves a prior on what it touched, drop "
        "forgets it, keep keeps it, so that the window grows",
        choices=("marginalize", "drop", "keep"),
    )
    jacobians: str = option(
        "first_estimate",
        "--jacobians",
        "where Jacobians of states that the prior touches are taken: at their first estimates, or "
        "at the current ones, the prior staying where it is or moving along (relinearize-prior); "
        "the last two make yaw seem known",
        choices=("first_estimate", "current", "relinearize_prior"),
    )
    prior_form: str = option(
        "information",
        "--prior-form",
        "how the prior is kept: its information matrix, or a square root of it by QR",
        choices=("information", "square_root"),
    )
    precision: str = option(
        "double",
        "--prior-precision",
        "precision in which the prior is made and kept",
        choices=("double", "single"),
    )
    loss: str = option(
        "cauchy",
        "--loss",
        "robust loss of reprojection errors",
        choices=("trivial", "huber", "soft_l1", "cauchy"),
    )
    loss_scale: float = option(
        1.0, "--loss-scale", "error at which it begins to bend, in sigmas", above=0.0, metavar="X"
    )
    pixel_sigma: float = option(
        1.0, "--pixel-sigma", "sigma of an image coordinate, pixels", above=0.0, metavar="PX"
    )
    imu_noise_scale: float = option(
        5.0,
        "--imu-noise-scale",
        "factor of the noise densities of gyroscope and accelerometer: data sheets know no "
        "vibration",
        above=0.0,
        metavar="X",
    )
    integration: str = option(
        "zero_order_hold",
        "--integration",
        "between two samples: the first of them, or their mean",
        choices=("zero_order_hold", "midpoint"),
    )
    refine_extrinsics: bool = option(
        False,
        "--refine-extrinsics",
        "refine camera_from_imu, too, which is taken to be given to 3 degrees and 5 cm",
    )
    refine_time_offset: bool = option(
        False, "--refine-time-offset", "refine the time offset of the images, too"
    )
    max_num_iterations: int = option(
        8, "--max-iterations", "maximum number of steps per frame", minimum=1, metavar="N"
    )
    time_budget: float = option(
        0.04,
        "--time-budget",
        "seconds of a solve after which no step begins; the best state so far is kept",
        above=0.0,
        metavar="S",
    )
    function_tolerance: float = option(
        1e-5,
        "--function-tolerance",
        "stop when |change of cost| < X * cost",
        minimum=0.0,
        metavar="X",
    )
    frame_rate: float = option(
        10.0,
        "--frame-rate",
        "images per second that are solved for; of faster cameras every so many images are taken",
        above=0.0,
        metavar="HZ",
    )
    min_parallax: float = option(
        30.0,
        "--min-parallax",
        "median motion of the tracks since the last keyframe that makes a keyframe, pixels",
        minimum=0.0,
        metavar="PX",
    )
    min_tracks: int = option(
        10, "--min-tracks", "fewer tracks in common make a keyframe", minimum=0, metavar="N"
    )
    max_interval: float = option(
        0.5, "--max-interval", "seconds after which a keyframe follows", above=0.0, metavar="S"
    )
    min_translation: float = option(
        0.02,
        "--min-translation",
        "motion below which nothing makes a keyframe, metres",
        minimum=0.0,
        metavar="M",
    )
    marginal_parallax: float = option(
        2.0,
        "--marginal-parallax",
        "landmarks of the oldest keyframe that moved less are not marginalised with it but go on "
        "from their next image, pixels",
        minimum=0.0,
        metavar="PX",
    )
    start_position_sigma: float = option(
        0.0,
        "--start-position-sigma",
        "prior on the first position, metres; 0: none, and where the world begins stays free",
        minimum=0.0,
        metavar="M",
    )
    start_yaw_sigma: float = option(
        0.0,
        "--start-yaw-sigma",
        "prior on the first yaw, degrees; 0: none",
        minimum=0.0,
        metavar="DEG",
    )
    start_gyro_bias_sigma: float = option(
        0.02,
        "--start-gyro-bias-sigma",
        "prior on the first gyroscope bias, rad/s",
        above=0.0,
        metavar="X",
    )
    start_accel_bias_sigma: float = option(
        0.2,
        "--start-accel-bias-sigma",
        "prior on the first accelerometer bias, m/s^2",
        above=0.0,
        metavar="X",
    )
    steady_speed_sigma: float = option(
        0.0,
        "--steady-speed-sigma",
        "while nothing excites the accelerometer, take the speed for steady to this acceleration, "
        "m/s^2, so that the scale is held; 0: do not. Wrong for what brakes gently and evenly",
        minimum=0.0,
        metavar="X",
    )
    nullity: bool = option(
        False,
        "--nullity",
        "count the directions that nothing in the window sees, per keyframe",
    )
    covariance: bool = option(False, "--covariance", "covariance of the newest state, per keyframe")
