"""ROS 1 and ROS 2 bags: images and IMU samples of one topic each, read by rosbags.

Stamps are those of the message headers; if a topic has none, the times of receipt. Messages of
images are read twice: once for their stamps, once for their pixels; one is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import require_package
from bundle.base.words import plural
from bundle.errors import InputError, first_line, shown
from bundle.io.sequences.grey_images import GreyScale, check_size, decoded
from bundle.io.sequences.recording_calibration import FoundCalibration, find_calibration, rostopic
from bundle.model.sequence.calibration import read_yaml
from bundle.model.sequence.sequence import Recording

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
    with _opened(path) as bag:
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
        images=lambda first, last: _images(path, images, found, first, last),
        calibration=found.calibration,
        notes=(f"Topics: {images} and {imu}.", *note, *imu_note, *found.notes),
        imu_place=lambda row: f"{shown(path)}: {imu}: message {row + 1}",
        image_place=lambda row: f"{shown(path)}: {images}: message {row + 1}",
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
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


def _images(
    path: Path, topic: str, found: FoundCalibration, first: int, last: int
) -> Iterator[NDArray[np.uint8]]:
    scale, size = GreyScale(), found.size
    with _opened(path) as bag:
        for number, (_, message) in enumerate(_messages(bag, topic)):
            if number >= last:
                return
            if number < first:
                continue
            place = f"{shown(path)}: {topic}: message {number + 1}"
            if hasattr(message, "encoding"):
                image = _grey(message, place)
            else:
                image = decoded(np.asarray(message.data).tobytes(), place)
            size = check_size(image, size, place)
            yield scale.grey(image)


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
