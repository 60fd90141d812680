"""Reading of recordings: images and IMU samples in one of several formats."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import require_package
from bundle.base.paths import as_path, numbered_lines
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief, first_line, shown
from bundle.io.recognition import RECORDINGS, mav_root, sequence_at
from bundle.io.sequences.grey_images import decoded, grey_images, images_of_files, require_opencv
from bundle.io.sequences.recording_calibration import find_calibration, rostopic
from bundle.io.sequences.trajectory_files import CsvTable, read_csv
from bundle.model.sequence.calibration import read_yaml
from bundle.model.sequence.sequence import Recording


@dataclass(frozen=True)
class RecordingSource:
    """Parts of a recording that its path does not determine."""

    # files of calibrations: this package's, or Kalibr's of camera and IMU
    calibration: tuple[str | os.PathLike[str], ...] = ()
    camera: str = "cam0"  # name of the camera: a folder of mav0, and an entry of a camchain
    imu: str | os.PathLike[str] | None = None  # table of the IMU's samples, of a video
    # times of the frames, of a video; None: a constant rate from 0
    frame_times: str | os.PathLike[str] | None = None
    # image_topic, imu_topic: topics of a ROS bag; None: the only one
    image_topic: str | None = None
    imu_topic: str | None = None


_ONLY_OF = {
    "imu": "video",
    "frame_times": "video",
    "image_topic": "rosbag",
    "imu_topic": "rosbag",
}


def read_recording(path: str | os.PathLike[str], source: RecordingSource) -> Recording:
    """Read samples, calibration and list of images."""
    format = sequence_at(as_path(path))
    if format not in RECORDINGS:
        expected = ", ".join(RECORDINGS.values())
        raise InputError(f"{shown(path)}: expected images and IMU samples: {expected}")
    for name, only in _ONLY_OF.items():
        if getattr(source, name) is not None and format != only:
            raise InputError(
                f"{name}: valid only with {RECORDINGS[only]}, found {RECORDINGS[str(format)]}"
            )
    require_opencv(f"{shown(path)}: images")
    files = tuple(as_path(each) for each in source.calibration)
    if format == "rosbag":
        topics = source.image_topic, source.imu_topic
        return read_bag(as_path(path), files, source.camera, *topics)
    if format == "video":
        imu, times = (
            None if each is None else as_path(each) for each in (source.imu, source.frame_times)
        )
        return read_video(as_path(path), imu, times, files, source.camera)
    return read_mav(path, files, source.camera)


# Folders of EuRoC and TUM-VI: images of a camera and samples of an IMU.
#
# The path is ``mav0`` or its parent::
#
#     mav0/cam0/data.csv       stamp [ns], file name (with or without its extension)
#     mav0/cam0/data/*.png
#     mav0/cam0/sensor.yaml    lens, T_BS, rate (TUM-VI: dso/camchain.yaml beside mav0)
#     mav0/imu0/data.csv       stamp [ns], angular rate [rad/s], specific force [m/s^2]
#     mav0/imu0/sensor.yaml    noise densities, T_BS, rate (TUM-VI: dso/imu_config.yaml)

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff")


def read_mav(
    path: str | os.PathLike[str],
    calibration: Sequence[str | os.PathLike[str]] = (),
    camera: str = "cam0",
) -> Recording:
    """Read samples, calibration and list of images; images are read when they are needed.

    ``path``: ``mav0`` or its parent.
    """
    given = as_path(path)
    root = mav_root(given) or given
    for name in (camera, "imu0"):
        if not (root / name / "data.csv").is_file():
            raise InputError(f"{shown(root)}: expected {name}/data.csv; it is missing")
    stamps, files, lines = _image_list(root / camera)
    imu = read_imu_csv(root / "imu0" / "data.csv")
    beside = root.parent / "dso"
    found = find_calibration(
        [as_path(each) for each in calibration],
        [root / camera / "sensor.yaml", beside / "camchain.yaml"],
        [root / "imu0" / "sensor.yaml", beside / "imu_config.yaml"],
        camera,
        (stamps, imu.whole[:, 0]),
    )
    table = shown(root / camera / "data.csv")

    def images(first: int, last: int) -> Iterator[NDArray[np.uint8]]:
        return grey_images(images_of_files(files[first:last]), found.size)

    return Recording(
        name=shown(given),
        imu_timestamps_ns=imu.whole[:, 0],
        gyro=imu.numbers[:, :3],
        accel=imu.numbers[:, 3:],
        image_timestamps_ns=stamps,
        images=images,
        calibration=found.calibration,
        notes=found.notes,
        imu_place=imu.place,
        image_place=lambda row: f"{table}: line {lines[row]}" if row < len(lines) else table,
    )


def read_imu_csv(path: Path) -> Any:
    """Read EuRoC's table of an IMU."""
    return read_csv(path, ["timestamp"], ["wx", "wy", "wz", "ax", "ay", "az"])


def _image_list(folder: Path) -> tuple[NDArray[np.int64], list[Path], list[int]]:
    """Return the stamps, the files and their lines in the table."""
    table, data = folder / "data.csv", folder / "data"
    if not data.is_dir() and (folder / "images").is_dir():
        data = folder / "images"
    known = {entry.name for entry in os.scandir(data)} if data.is_dir() else set()
    stamps: list[int] = []
    files: list[Path] = []
    lines: list[int] = []
    missing, first = 0, ""
    for number, line in numbered_lines(table):
        words = [word.strip() for word in line.split(",")]
        if not words[0] or words[0].startswith("#") or (not lines and words[0][0].isalpha()):
            continue
        place = f"{shown(table)}: line {number}"
        if len(words) > 2 or not _is_stamp(words[0]):
            raise InputError(
                f"{place}: expected a stamp in nanoseconds and a file name, found {brief(line)}"
                + ("; a stamp in seconds?" if _is_decimal(words[0]) else "")
            )
        name = (words[1:] or [""])[0] or words[0]
        name = next((name + end for end in ("", *SUFFIXES) if name + end in known), name)
        if name not in known:
            missing += 1
            first = first or f"{place}: expected the image {shown(data / name)}; it is missing"
        stamps.append(int(words[0]))
        files.append(data / name)
        lines.append(number)
    if missing:
        raise InputError(f"{first} ({missing} of {len(files)} are)")
    return np.array(stamps, np.int64), files, lines


def _is_stamp(word: str) -> bool:
    return word.isdecimal() and int(word) < 2**63


def _is_decimal(word: str) -> bool:
    try:
        return float(word) < 1e11
    except ValueError:
        return False


# A video with the samples of an IMU in a table, as action cameras and telephones record them.
#
# Frames have the times of ``--frame-times``, one a line, or a constant rate from 0. The first
# column of the IMU's table is on the same clock. Both are integers of nanoseconds, or seconds if a
# number has a decimal point. The other columns are EuRoC's: rad/s, m/s^2.

COLUMNS = ["wx", "wy", "wz", "ax", "ay", "az"]
SLACK = 2  # frames that a container may count and not hold


def read_video(
    path: Path,
    imu: Path | None,
    frame_times: Path | None = None,
    calibration: Sequence[Path] = (),
    camera: str = "cam0",
) -> Recording:
    """Read samples and times of frames; frames are decoded when they are needed.

    ``frame_times``: times of the frames; None: a constant rate from 0.
    """
    if imu is None:
        raise InputError(f"{shown(path)}: a video: expected --imu FILE with the IMU's samples")
    count, rate = _frames(path)
    if frame_times is None:
        stamps: NDArray[np.int64] = np.rint(1e9 / rate * np.arange(count)).astype(np.int64)
        note = f"Frames: {count} from time 0, at the rate of the container, {rate:.6g} per second."
    else:
        table = _table(frame_times, [])
        stamps = table.whole[:, 0]
        note = f"Frames: times of {shown(frame_times)}."
        if abs(len(stamps) - count) > SLACK:
            raise InputError(
                f"{shown(frame_times)}: expected the times of {count} frames of {shown(path)}, "
                f"found {len(stamps)}"
            )
    samples = _table(imu, COLUMNS)
    found = find_calibration(calibration, [], [], camera, (stamps, samples.whole[:, 0]))

    def images(first: int, last: int) -> Iterator[NDArray[np.uint8]]:
        return grey_images(_images(path, first, last, count), found.size)

    def place(row: int) -> str:
        return f"{shown(path)}: frame {row + 1}" if frame_times is None else table.place(row)

    return Recording(
        name=shown(path),
        imu_timestamps_ns=samples.whole[:, 0],
        gyro=samples.numbers[:, :3],
        accel=samples.numbers[:, 3:],
        image_timestamps_ns=stamps,
        images=images,
        calibration=found.calibration,
        notes=(note, *found.notes),
        imu_place=samples.place,
        image_place=place,
    )


def _table(path: Path, columns: list[str]) -> CsvTable:
    """Read a table whose first column is a time; return it in nanoseconds."""
    lines = (text.split(",")[0].strip() for _, text in numbered_lines(path))
    if not any("." in word for word in lines if word[:1].isdigit() or word[:1] == "-"):
        return read_csv(path, ["timestamp"], columns)
    table = read_csv(path, [], ["timestamp", *columns])
    times = 1e9 * table.numbers[:, :1]
    wrong = np.flatnonzero(~(np.abs(times[:, 0]) < 2**63))
    if len(wrong):
        raise InputError(f"{table.place(int(wrong[0]))}: timestamp: expected seconds")
    whole = np.rint(times).astype(np.int64)
    return CsvTable(whole, table.numbers[:, 1:], table.lines, table.name)


def _opened(path: Path) -> Any:
    import cv2

    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        with path.open("rb"):  # raises the error of the system
            pass
        raise InputError(f"{shown(path)}: expected a video that OpenCV can decode")
    return video


def _frames(path: Path) -> tuple[int, float]:
    """Return the number of frames and the rate that the container states."""
    import cv2

    video = _opened(path)
    count, rate = round(video.get(cv2.CAP_PROP_FRAME_COUNT)), video.get(cv2.CAP_PROP_FPS)
    video.release()
    if count < 1 or not 0.1 < rate < 2000:
        raise InputError(
            f"{shown(path)}: expected a number of frames and their rate in the container, found "
            f"{count} and {rate:g}"
        )
    return count, float(rate)


def _images(path: Path, first: int, last: int, count: int) -> Iterator[tuple[NDArray[Any], str]]:
    """Yield frames of a video, grey, with their places."""
    import cv2

    video = _opened(path)
    try:
        for number in range(last):
            if not video.grab():
                if number < count - SLACK:
                    raise InputError(
                        f"{shown(path)}: expected {count} frames, found {number}: a truncated video"
                    )
                return
            if number < first:
                continue
            decoded, frame = video.retrieve()
            if not decoded:
                raise InputError(f"{shown(path)}: frame {number + 1}: expected an image")
            image: Any = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
            yield image, f"{shown(path)}: frame {number + 1}"
    finally:
        video.release()


# ROS 1 and ROS 2 bags: images and IMU samples of one topic each, read by rosbags.
#
# Stamps are those of the message headers; if a topic has none, the times of receipt. Messages of
# images are read twice: once for their stamps, once for their pixels; one is in memory at a time.

IMU = "sensor_msgs/msg/Imu"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# encodings with the number of their channels, and OpenCV's conversion to grey
_ENCODINGS: dict[str, tuple[Any, int, str]] = {
    **dict.fromkeys(("mono8", "8UC1"), (np.uint8, 1, "")),
    **dict.fromkeys(("mono16", "16UC1"), (np.uint16, 1, "")),
    **dict.fromkeys(("bgr8", "8UC3"), (np.uint8, 3, "COLOR_BGR2GRAY")),
    "rgb8": (np.uint8, 3, "COLOR_RGB2GRAY"),
    "bgra8": (np.uint8, 4, "COLOR_BGRA2GRAY"),
    "rgba8": (np.uint8, 4, "COLOR_RGBA2GRAY"),
    # OpenCV names Bayer patterns by the second row and column.
    "bayer_rggb8": (np.uint8, 1, "COLOR_BayerBG2GRAY"),
    "bayer_bggr8": (np.uint8, 1, "COLOR_BayerRG2GRAY"),
    "bayer_gbrg8": (np.uint8, 1, "COLOR_BayerGR2GRAY"),
    "bayer_grbg8": (np.uint8, 1, "COLOR_BayerGB2GRAY"),
    **dict.fromkeys(("yuv422", "uyvy"), (np.uint8, 2, "COLOR_YUV2GRAY_UYVY")),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), (np.uint8, 2, "COLOR_YUV2GRAY_YUY2")),
}


def read_bag(
    path: Path,
    calibration: Sequence[Path] = (),
    camera: str = "cam0",
    image_topic: str | None = None,
    imu_topic: str | None = None,
) -> Recording:
    """Read samples and stamps of images; images are read when they are needed.

    ``path``: a ROS 1 bag, or the folder of a ROS 2 bag. ``image_topic``: topic; None: the rostopic
    of the calibration, or the only one.
    """
    require_package("rosbags", "rosbags", f"{shown(path)}: a ROS bag")
    with _opened_bag(path) as bag:
        images = _topic(path, bag, IMAGES, image_topic, "image", calibration, camera)
        imu = _topic(path, bag, (IMU,), imu_topic, "imu", calibration, camera)
        samples = [
            (_stamp(message), received, message.angular_velocity, message.linear_acceleration)
            for received, message in _messages(bag, imu)
        ]
        frames = [(_stamp(message), received) for received, message in _messages(bag, images)]
    imu_stamps, imu_note = _stamps([each[:2] for each in samples], imu)
    stamps, note = _stamps(frames, images)
    vectors = np.array(
        [[v.x, v.y, v.z, f.x, f.y, f.z] for _, _, v, f in samples], np.float64
    ).reshape(-1, 6)
    found = find_calibration(calibration, [], [], camera, (stamps, imu_stamps))
    return Recording(
        name=shown(path),
        imu_timestamps_ns=imu_stamps,
        gyro=vectors[:, :3],
        accel=vectors[:, 3:],
        image_timestamps_ns=stamps,
        images=lambda first, last: grey_images(
            _images_of_bag(path, images, first, last), found.size
        ),
        calibration=found.calibration,
        notes=(f"Topics: {images} and {imu}.", *note, *imu_note, *found.notes),
        imu_place=lambda row: f"{shown(path)}: {imu}: message {row + 1}",
        image_place=lambda row: f"{shown(path)}: {images}: message {row + 1}",
    )


@contextmanager
def _opened_bag(path: Path) -> Iterator[Any]:
    """Open a bag; errors of its format become one line."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            yield bag
    except (InputError, OSError, MemoryError):
        raise
    except Exception as error:  # rosbags has many, and a damaged file raises others
        raise InputError(
            f"{shown(path)}: expected a whole ROS bag, found: {first_line(error)}"
        ) from None


def _topic(
    path: Path,
    bag: Any,
    types: Sequence[str],
    asked: str | None,
    sensor: str,
    calibration: Sequence[Path],
    camera: str,
) -> str:
    """Return the topic that was asked for, that the calibration names, or the only one."""
    topics = sorted({each.topic for each in bag.connections if each.msgtype in types})
    flag = f"--{sensor}-topic"
    if asked is not None:
        if asked not in topics:
            raise InputError(
                f"{flag}: expected a topic of {shown(path)} ({', '.join(topics) or 'none fits'}), "
                f"found {asked}"
            )
        return asked
    named = [rostopic(read_yaml(each), camera, sensor) for each in calibration]
    chosen: list[str] = [topic for topic in named if topic in topics] or topics
    if len(chosen) == 1:
        return chosen[0]
    if not topics:
        others = sorted({each.topic for each in bag.connections})
        raise InputError(
            f"{shown(path)}: expected a topic of {' or '.join(types)}, found "
            f"{', '.join(others) or 'an empty bag'}"
        )
    raise InputError(
        f"{shown(path)}: expected one {sensor} topic, found {len(topics)}; give {flag} "
        f"{' or '.join(topics)}"
    )


def _messages(bag: Any, topic: str) -> Iterator[tuple[int, Any]]:
    """Yield the time of receipt and the message."""
    connections = [each for each in bag.connections if each.topic == topic]
    for connection, received, raw in bag.messages(connections=connections):
        yield received, bag.deserialize(raw, connection.msgtype)


def _stamp(message: Any) -> int:
    stamp = message.header.stamp
    return 1_000_000_000 * int(stamp.sec) + int(stamp.nanosec)


def _stamps(
    pairs: Sequence[tuple[int, int]], topic: str
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the stamps of headers, or the times of receipt if headers have none."""
    times = np.array(pairs, np.int64).reshape(-1, 2)
    if len(times) and not times[:, 0].any():
        note = f"{topic}: {plural(len(times), 'header')} without stamps; times of receipt are used."
        return times[:, 1], (note,)
    return times[:, 0], ()


def _images_of_bag(
    path: Path, topic: str, first: int, last: int
) -> Iterator[tuple[NDArray[Any], str]]:
    """Yield images of a topic, grey, with their places."""
    with _opened_bag(path) as bag:
        for number, (_, message) in enumerate(_messages(bag, topic)):
            if number >= last:
                return
            if number < first:
                continue
            place = f"{shown(path)}: {topic}: message {number + 1}"
            if hasattr(message, "encoding"):
                yield _grey(message, place), place
            else:
                yield decoded(np.asarray(message.data).tobytes(), place), place


def _grey(message: Any, place: str) -> NDArray[Any]:
    """Return the grey values of sensor_msgs/Image."""
    import cv2

    encoding = _ENCODINGS.get(message.encoding)
    if encoding is None:
        raise InputError(
            f"{place}: expected an encoding of {', '.join(_ENCODINGS)}, found {message.encoding}"
        )
    kind, channels, conversion = encoding
    value = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    width = message.width * channels * value.itemsize
    data = np.asarray(message.data, np.uint8)
    if message.height * message.width == 0 or message.step < width:
        raise InputError(f"{place}: expected an image, found {message.width} x {message.height}")
    if len(data) < message.height * message.step:
        raise InputError(
            f"{place}: expected {message.height * message.step} bytes, found {len(data)}"
        )
    rows = data[: message.height * message.step].reshape(message.height, message.step)[:, :width]
    values = np.ascontiguousarray(rows).view(value).astype(kind)
    if channels > 1:
        values = values.reshape(message.height, message.width, channels)
    if not conversion:
        return np.asarray(values)
    return np.asarray(cv2.cvtColor(values, getattr(cv2, conversion)))
