"""Arguments of IMUs and recordings: `bundle vio`, `info`, `convert`, and `refine` with an IMU."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.base.records import dataclass
from bundle.cli.option_flags import argument, fields, file_argument, group, naming_flags
from bundle.cli.path_checks import page_path, reconstruction, telemetry_path, trajectory_path
from bundle.errors import InputError
from bundle.interface.window_options import TrackingOptions

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.interface.options import SolveOptions
    from bundle.interface.solve_record import Progress
    from bundle.model.problem import Problem
    from bundle.solving.rounds.plan import RunPlan

ELSEWHERE = (
    *("only_images", "hold_out", "checkpoint", "resume", "loops", "rules", "constraints"),
    *("fixed_image_ids", "fixed_point_ids", "database"),
)
"""Arguments of other ways to refine, which are not valid with an IMU."""


@dataclass(frozen=True)
class InertialFiles:
    """Files of an adjustment with an IMU."""

    imu: str  # samples: timestamp in ns, three rates in rad/s, three forces in m/s^2
    frame_times: str  # name and time in ns of each image
    calibration: tuple[str, ...]  # calibration.yaml, or Kalibr's two files
    noise_scale: float | None  # factor on the noise densities; None: by the rate of the images
    samples: str  # kind of the samples: "auto", "instant" or "interval"


IMU = group(
    "samples of an IMU between the images of a video",
    file_argument(
        "--imu",
        help="samples: timestamp in ns, rates in rad/s, forces in m/s^2, comma separated, as "
        "EuRoC's (default: none)",
    ),
    file_argument(
        "--frame-times",
        help="lines of image name and time in ns on the clock of the camera; only with --imu "
        "(default: none)",
    ),
    file_argument(
        "--calibration",
        action="append",
        help="calibration.yaml, or Kalibr's camchain-imucam.yaml and, in a second --calibration, "
        "imu.yaml: camera_from_imu, noise, time offset; only with --imu (default: none)",
    ),
    argument(
        "--imu-noise-scale",
        metavar="X",
        type=float,
        help="factor on the noise densities of gyroscope and accelerometer, because data sheets "
        "do not include vibration; only with --imu (default: 5 for 4 images per second, in "
        "proportion to the root of the time between images, at least 1)",
    ),
    argument(
        "--imu-samples",
        choices=("auto", "instant", "interval"),
        help="instant: samples at their stamps; interval: means over the interval that follows; "
        "only with --imu (default: auto, as fits the images)",
    ),
    description="The model is brought into metres with z up, and adjusted with the IMU's motions.",
)


RECORDED = (
    *("calibration", "camera", "imu", "frame_times", "image_topic", "imu_topic"),
    *(field.name for field in dataclasses.fields(TrackingOptions)),
)
"""Destinations of the flags of ``RECORDING``, which inputs without images refuse."""
RECORDING = group(
    "images of a visual-inertial sequence",
    file_argument(
        "--calibration",
        action="append",
        help="calibration in place of that in the sequence: calibration.yaml, or Kalibr's "
        "camchain-imucam.yaml and, given by a second --calibration or beside it, imu.yaml "
        "(default: sensor.yaml of mav0, or dso/camchain.yaml beside it; bags and videos have none)",
        use=5,
    ),
    argument(
        "--camera",
        metavar="NAME",
        help="camera whose images are tracked: a folder of mav0, an entry of a camchain (default: "
        "cam0)",
        use=6,
    ),
    file_argument(
        "--imu",
        help="samples of the IMU for a video: a csv of stamp, angular rate x y z [rad/s], specific "
        "force x y z [m/s^2]; stamps are integers of nanoseconds, or seconds with a decimal point",
        use=7,
    ),
    file_argument(
        "--frame-times",
        help="times of the frames of a video, one a line, on the clock of --imu (default: the "
        "constant rate of the video, from 0)",
    ),
    *(
        argument(
            f"--{sensor}-topic",
            metavar="TOPIC",
            help=f"topic of the {name} in a ROS bag (default: the rostopic of the calibration, or "
            "the only topic)",
        )
        for sensor, name in (("image", "images"), ("imu", "IMU samples"))
    ),
    fields("TrackingOptions"),
)
ODOMETRY = (
    argument(
        "sequence",
        metavar="SEQUENCE",
        type=reconstruction,
        help="images and IMU samples: EuRoC's or TUM-VI's mav0 or its parent, a ROS 1 or 2 bag, or "
        "a video with --imu; or tracks in place of images: a folder with imu.csv, tracks.csv and "
        "calibration.yaml, or a table of both that bundle convert reads",
    ),
    argument(
        "-o",
        "--output",
        metavar="FILE.tum",
        type=trajectory_path,
        required=True,
        help="poses world_from_imu of the solved images, one per line: timestamp in seconds, tx ty "
        "tz, qx qy qz qw; z is up",
        use=1,
    ),
    file_argument(
        "--ground-truth",
        help="compare with it: EuRoC's csv or a TUM file",
        use=4,
    ),
    argument(
        "--telemetry",
        metavar="FILE.jsonl",
        type=telemetry_path,
        help="one line of JSON per keyframe, written when the keyframe is complete",
    ),
    argument(
        "--html",
        metavar="PAGE",
        type=page_path(),
        help="a page with the curves of the telemetry and the path, a single file",
        use=90,
    ),
    group(
        "two loops",
        argument(
            "--publish",
            metavar="FILE.tum",
            type=trajectory_path,
            help="a pose per IMU sample: the last solution of the window, propagated and corrected "
            "by closures",
            use=20,
        ),
        file_argument(
            "--loops",
            help="closures: csv of first_timestamp_ns, second_timestamp_ns, tx ty tz, qx qy qz qw "
            "of the IMU at the second time in its frame at the first, sigmas in metres and "
            "degrees; or a g2o file whose ids are the stamps",
        ),
        argument(
            "--real-time",
            action="store_true",
            help="replay at the rate of the sensors and report how late the poses are",
        ),
    ),
)


def inertial_given(arguments: argparse.Namespace) -> InertialFiles | None:
    """Return the files of the IMU; None without any. Refuse flags that have no effect with it."""
    given: dict[str, Any] = {
        "--frame-times": arguments.frame_times,
        "--calibration": arguments.calibration,
        "--imu-noise-scale": arguments.imu_noise_scale,
        "--imu-samples": arguments.imu_samples,
    }
    if arguments.imu is None:
        for flag, value in given.items():
            if value is not None:
                raise InputError(f"{flag}: valid only with --imu")
        return None
    for flag in ("--frame-times", "--calibration"):
        if given[flag] is None:
            raise InputError(f"--imu: expected {flag} FILE, too")
    for name in ELSEWHERE:
        if getattr(arguments, name, None) not in (None, (), False):
            raise InputError(f"{arguments.flags[name]}: not valid with --imu")
    return InertialFiles(
        arguments.imu,
        arguments.frame_times,
        tuple(map(str, arguments.calibration)),
        arguments.imu_noise_scale,
        arguments.imu_samples or "auto",
    )


def adjusted_with_imu(
    given: InertialFiles,
    problem: Problem,
    options: SolveOptions,
    priors: tuple[Prior, ...],
    plan: RunPlan,
    progress: Progress,
) -> InertialAdjustment:
    """Adjust a problem with the samples of an IMU, with priors, and by a plan."""
    from bundle.inertial.offline.image_intervals import read_image_times
    from bundle.inertial.offline.imu_adjustment import adjust_with_imu
    from bundle.inertial.offline.inertial_result import ImuSamples
    from bundle.io.sequences.recording_calibration import find_calibration, kind_of_yaml
    from bundle.io.sequences.trajectory_files import read_csv
    from bundle.model.sequence.calibration import load_calibration, read_yaml
    from bundle.model.sequence.sequence import check_imu, check_stamp_unit

    times = read_image_times(given.frame_times, problem)
    table = read_csv(given.imu, ["timestamp"], ["wx", "wy", "wz", "ax", "ay", "az"])
    samples = ImuSamples(table.whole[:, 0], table.numbers[:, :3], table.numbers[:, 3:])
    check_imu(*samples, table.place)
    paths = [Path(path) for path in given.calibration]
    stamps = (times, samples.timestamps_ns)
    if len(paths) == 1 and kind_of_yaml(read_yaml(paths[0])) == "own":
        calibration = load_calibration(paths[0])  # its camera model is not used
    else:
        calibration = find_calibration(paths, [], [], "cam0", stamps).calibration
    check_stamp_unit(samples.timestamps_ns, calibration.imu_rate, "imu_rate", table.place)
    with naming_flags(imu="--imu", imu_noise_scale="--imu-noise-scale"):
        return adjust_with_imu(
            problem,
            samples,
            times + round(1e9 * calibration.time_offset),
            calibration.camera_from_imu,
            calibration.noise,
            options,
            imu_noise_scale=given.noise_scale,
            imu_samples=given.samples,
            priors=priors,
            plan=plan,
            progress=progress,
            place=table.place,
        )
