"""Samples of an IMU in `bundle refine`: flags, refusals, and the adjustment."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bundle.base.records import dataclass
from bundle.cli.option_flags import naming_flags
from bundle.cli.path_checks import a_path
from bundle.errors import InputError

if TYPE_CHECKING:
    from bundle.inertial.offline.inertial_result import InertialAdjustment
    from bundle.interface.options import SolveOptions
    from bundle.interface.round_options import RoundOptions
    from bundle.interface.solve_record import Progress
    from bundle.model.problem import Problem
    from bundle.solving.placed_problem import Prior

ELSEWHERE = (
    *("only_images", "hold_out", "checkpoint", "resume", "loops", "rules", "constraints"),
    *("fixed_image_ids", "fixed_point_ids"),
)
"""Arguments of other ways to refine, which are not valid with an IMU."""


@dataclass(frozen=True)
class InertialFiles:
    """Files of an adjustment with an IMU.

    Attributes:
        imu: samples: timestamp in ns, three rates in rad/s, three forces in m/s^2.
        frame_times: name and time in ns of each image.
        calibration: calibration.yaml, or Kalibr's two files.
        noise_scale: factor on the noise densities; None: by the rate of the images.
        samples: kind of the samples: "auto", "instant" or "interval".
    """

    imu: str
    frame_times: str
    calibration: tuple[str, ...]
    noise_scale: float | None
    samples: str


def add_inertial_flags(parser: argparse.ArgumentParser) -> None:
    """Add the flags of an adjustment with an IMU."""
    group = parser.add_argument_group(
        "samples of an IMU between the images of a video",
        "The model is brought into metres with z up, and adjusted with the IMU's motions.",
    )
    group.add_argument(
        "--imu",
        metavar="FILE",
        type=a_path,
        help="samples: timestamp in ns, rates in rad/s, forces in m/s^2, comma separated, as "
        "EuRoC's (default: none)",
    )
    group.add_argument(
        "--frame-times",
        metavar="FILE",
        type=a_path,
        help="lines of image name and time in ns on the clock of the camera; only with --imu "
        "(default: none)",
    )
    group.add_argument(
        "--calibration",
        metavar="FILE",
        type=a_path,
        action="append",
        help="calibration.yaml, or Kalibr's camchain-imucam.yaml and, in a second --calibration, "
        "imu.yaml: camera_from_imu, noise, time offset; only with --imu (default: none)",
    )
    group.add_argument(
        "--imu-noise-scale",
        metavar="X",
        type=float,
        help="factor on the noise densities of gyroscope and accelerometer, because data sheets "
        "do not include vibration; only with --imu (default: 5 for 4 images per second, in "
        "proportion to the root of the time between images, at least 1)",
    )
    group.add_argument(
        "--imu-samples",
        choices=("auto", "instant", "interval"),
        help="instant: samples at their stamps; interval: means over the interval that follows; "
        "only with --imu (default: auto, as fits the images)",
    )


def inertial_given(arguments: argparse.Namespace) -> InertialFiles | None:
    """Return the files of the IMU; None without any.

    Raises:
        InputError: a file is missing, or another flag is not valid with an IMU.
    """
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
    rounds: RoundOptions,
    progress: Progress,
) -> InertialAdjustment:
    """Adjust a problem with the samples of an IMU, with priors, and in rounds if requested.

    Raises:
        InputError: a file is wrong, or the samples do not fit the images.
        OSError: a file cannot be read.
    """
    from bundle.inertial.offline.image_intervals import read_image_times
    from bundle.inertial.offline.imu_adjustment import adjust_with_imu
    from bundle.inertial.offline.inertial_result import ImuSamples
    from bundle.io.sequences.csv_tables import read_csv
    from bundle.io.sequences.recording_calibration import find_calibration, kind_of_yaml
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
            rounds=rounds,
            progress=progress,
            place=table.place,
        )
