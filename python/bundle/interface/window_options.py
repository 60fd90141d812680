"""Options of a sliding window, and of the tracking of features for it."""

from __future__ import annotations

from bundle.base.records import dataclass
from bundle.interface.option_class import Options, documented
from bundle.interface.option_fields import option


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class WindowOptions(Options):
    """Options of :class:`bundle.SlidingWindow`.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    window: int = option(
        10,
        "--window",
        ("keyframes in the window, in addition to the newest frame"),
        minimum=2,
        metavar="N",
        use=3,
    )
    marginalize: str = option(
        "marginalize",
        "--marginalize",
        "treatment of the oldest keyframe. marginalize: replaced by a prior on the variables of "
        "its factors; drop: removed; keep: kept, so that the window grows",
        choices=("marginalize", "drop", "keep"),
    )
    jacobians: str = option(
        "first_estimate",
        "--jacobians",
        "estimates at which Jacobians of the prior's states are taken. first-estimate: the first "
        "estimates; current: the current estimates; relinearize-prior: the current estimates, to "
        "which the prior moves, too. With the last two, yaw seems to be observable",
        choices=("first_estimate", "current", "relinearize_prior"),
    )
    prior_form: str = option(
        "information",
        "--prior-form",
        "form of the prior: its information matrix, or a square root of it by QR",
        choices=("information", "square_root"),
    )
    precision: str = option(
        "double",
        "--prior-precision",
        "precision in which the prior is computed and stored",
        choices=("double", "single"),
    )
    loss: str = option(
        "cauchy",
        "--loss",
        "robust loss of reprojection errors",
        choices=("trivial", "huber", "soft_l1", "cauchy"),
        use=10,
    )
    loss_scale: float = option(
        1.0,
        "--loss-scale",
        ("error at which this loss begins to bend, in sigmas"),
        above=0.0,
        metavar="X",
        use=11,
    )
    pixel_sigma: float = option(
        0.0,
        "--pixel-sigma",
        "sigma of an image coordinate, pixels; 0: that of the calibration (1 for a window without)",
        minimum=0.0,
        metavar="PX",
    )
    imu_noise_scale: float = option(
        5.0,
        "--imu-noise-scale",
        "factor on the noise densities of gyroscope and accelerometer, because data sheets do not "
        "include vibration",
        above=0.0,
        metavar="X",
        use=8,
    )
    integration: str = option(
        "zero_order_hold",
        "--integration",
        "value of the IMU between two samples: the first sample, or the mean of both",
        choices=("zero_order_hold", "midpoint"),
    )
    refine_extrinsics: bool = option(
        False,
        "--refine-extrinsics",
        "refine camera_from_imu, too, with a prior of 3 degrees and 5 cm at its given value",
    )
    refine_time_offset: bool = option(
        False, "--refine-time-offset", "refine the time offset of the images, too"
    )
    max_num_iterations: int = option(
        8, "--max-iterations", "maximum number of steps per frame", minimum=1, metavar="N", use=80
    )
    time_budget: float = option(
        0.04,
        "--time-budget",
        "seconds of a solve after which no step begins; the best state so far is the result",
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
        "images per second that are solved; if the camera is faster, only every n-th image is used",
        above=0.0,
        metavar="HZ",
    )
    min_parallax: float = option(
        30.0,
        "--min-parallax",
        "median motion of the tracks since the last keyframe above which a frame becomes a "
        "keyframe, pixels",
        minimum=0.0,
        metavar="PX",
    )
    min_tracks: int = option(
        10,
        "--min-tracks",
        (
            "number of tracks in common with the last keyframe below which a frame becomes a "
            "keyframe"
        ),
        minimum=0,
        metavar="N",
    )
    max_interval: float = option(
        0.5,
        "--max-interval",
        ("seconds since the last keyframe after which a frame becomes a keyframe"),
        above=0.0,
        metavar="S",
    )
    min_translation: float = option(
        0.02,
        "--min-translation",
        "motion below which no frame becomes a keyframe, metres",
        minimum=0.0,
        metavar="M",
    )
    marginal_parallax: float = option(
        2.0,
        "--marginal-parallax",
        "motion below which landmarks of the oldest keyframe are not marginalised with it but "
        "continue from their next image, pixels",
        minimum=0.0,
        metavar="PX",
    )
    start_position_sigma: float = option(
        0.0,
        "--start-position-sigma",
        "prior on the first position, metres; 0: no prior, the origin of the world stays free",
        minimum=0.0,
        metavar="M",
    )
    start_yaw_sigma: float = option(
        0.0,
        "--start-yaw-sigma",
        "prior on the first yaw, degrees; 0: no prior",
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
        "while the accelerometer is not excited, assume a constant speed up to this acceleration, "
        "m/s^2, so that the scale does not drift; 0: no assumption. Wrong for gentle constant "
        "braking",
        minimum=0.0,
        metavar="X",
    )
    nullity: bool = option(
        False,
        "--nullity",
        "count the unobservable directions of the window at each keyframe",
    )
    covariance: bool = option(
        False, "--covariance", ("compute the covariance of the newest state at each keyframe")
    )


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class TrackingOptions(Options):
    """Options of tracking features through images.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    num_features: int = option(
        100,
        "--num-features",
        "number of cells of the grid over the usable pixels; each has at most one new corner",
        minimum=10,
        metavar="N",
    )
    max_backward_error: float = option(
        0.5,
        "--max-backward-error",
        "distance above which a track ends: tracked to the next image and back, a feature must "
        "return to its position, pixels",
        above=0.0,
        metavar="PX",
    )
    max_epipolar_error: float = option(
        1.0,
        "--max-epipolar-error",
        "distance from the epipolar line above which a track ends, pixels",
        above=0.0,
        metavar="PX",
    )
