"""A rendered flight in other forms: Kalibr's calibration, ROS bags, a video with a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from tests.inertial.images.rendered_flight import CAMERA_FROM_IMU, NOISE, SMALL

ENCODINGS = {"mono8": None, "bgr8": cv2.COLOR_GRAY2BGR, "rgba8": cv2.COLOR_GRAY2RGBA}


def write_kalibr(mav: Path) -> None:
    """Write camchain-imucam.yaml and imu.yaml beside mav0 of a small flight."""
    camera = {
        "T_cam_imu": CAMERA_FROM_IMU.tolist(),
        "camera_model": "pinhole",
        "distortion_coeffs": list(SMALL["lens"][1][4:]),
        "distortion_model": "radtan",
        "intrinsics": list(SMALL["lens"][1][:4]),
        "resolution": list(SMALL["size"]),
        "rostopic": "/cam0/image_raw",
    }
    (mav.parent / "camchain-imucam.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    (mav.parent / "imu.yaml").write_text(yaml.safe_dump({**NOISE, "rostopic": "/imu0"}))


def write_video(mav: Path) -> Path:
    """Write flight.avi, flight_imu.csv (seconds from the first frame) and frame_times.txt."""
    path = mav.parent / "flight.avi"
    images = frames(mav)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, SMALL["size"])
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
    for _, grey in images:
        writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    start = images[0][0]
    lines = (mav / "imu0/data.csv").read_text().splitlines()[1:]
    rows = [line.split(",", 1) for line in lines]
    seconds = [f"{(int(stamp) - start) / 1e9:.9f},{rest}" for stamp, rest in rows]
    (mav.parent / "flight_imu.csv").write_text("\n".join(["t,gx,gy,gz,ax,ay,az", *seconds]) + "\n")
    (mav.parent / "frame_times.txt").write_text("\n".join(str(stamp) for stamp, _ in images) + "\n")
    return path


def frames(mav: Path) -> list[tuple[int, Any]]:
    paths = sorted((mav / "cam0/data").iterdir())
    return [(int(path.stem), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in paths]


def write_bag(
    mav: Path,
    path: Path,
    ros: int,
    encoding: str = "mono8",
    cameras: tuple[str, ...] = ("/cam0/image_raw",),
    with_stamps: bool = True,
) -> Path:
    """Write the flight as a bag; "png" encodes images as CompressedImage."""
    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    known = types.types
    image_type = f"sensor_msgs/msg/{'CompressedImage' if encoding == 'png' else 'Image'}"

    def header(stamp: int) -> Any:
        used = stamp if with_stamps else 0
        time = known["builtin_interfaces/msg/Time"](sec=used // 10**9, nanosec=used % 10**9)
        more = {"seq": 0} if ros == 1 else {}
        return known["std_msgs/msg/Header"](stamp=time, frame_id="", **more)

    def image(stamp: int, grey: Any) -> Any:
        if encoding == "png":
            data = cv2.imencode(".png", grey)[1]
            return known[image_type](header=header(stamp), format="png", data=data.ravel())
        code = ENCODINGS[encoding]
        colour = grey if code is None else cv2.cvtColor(grey, code)
        rows = np.pad(colour.reshape(len(grey), -1), ((0, 0), (0, 8)))  # padded rows
        return known[image_type](
            header=header(stamp), height=grey.shape[0], width=grey.shape[1], encoding=encoding,
            is_bigendian=0, step=rows.shape[1], data=rows.ravel(),
        )  # fmt: skip

    vector, turn = known["geometry_msgs/msg/Vector3"], known["geometry_msgs/msg/Quaternion"]

    def sample(row: Any, stamp: int) -> Any:
        return known["sensor_msgs/msg/Imu"](
            header=header(stamp), orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9),
            angular_velocity=vector(*row[:3]), angular_velocity_covariance=np.zeros(9),
            linear_acceleration=vector(*row[3:]), linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip

    lines = (mav / "imu0/data.csv").read_text().splitlines()[1:]
    samples = [(int(line.split(",")[0]), np.array(line.split(",")[1:], float)) for line in lines]
    serialize = types.serialize_ros1 if ros == 1 else types.serialize_cdr
    with Writer1(path) if ros == 1 else Writer2(path, version=9) as bag:
        imu = bag.add_connection("/imu0", "sensor_msgs/msg/Imu", typestore=types)
        for stamp, row in samples:
            bag.write(imu, stamp, serialize(sample(row, stamp), "sensor_msgs/msg/Imu"))
        for topic in cameras:
            connection = bag.add_connection(topic, image_type, typestore=types)
            for stamp, grey in frames(mav):
                bag.write(connection, stamp, serialize(image(stamp, grey), image_type))
    return path
