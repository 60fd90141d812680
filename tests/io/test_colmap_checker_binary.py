"""Corruptions of binary COLMAP files: every one is named with its byte."""

import re
import struct
from pathlib import Path

import pycolmap
import pytest

from bundle.io import colmap
from tests.io.colmap_models import complaint, fields, write_files

NO_POINT = 2**64 - 1
NAN = float("nan")
INFINITY = float("inf")


def camera(camera_id: int = 1, model: int = 1, params: tuple[float, ...] = (500, 501, 320, 240)):
    return struct.pack(f"<IiQQ{len(params)}d", camera_id, model, 640, 480, *params)


def image(
    image_id: int, *keypoints: tuple[float, float, int], pose=(1, 0, 0, 0, 0, 0, 0), name=b"a"
) -> bytes:
    head = struct.pack("<I7dI", image_id, *pose, 1) + name + b"\0"
    body = b"".join(struct.pack("<ddQ", *keypoint) for keypoint in keypoints)
    return head + struct.pack("<Q", len(keypoints)) + body


def point(point_id: int, *track: tuple[int, int], xyz=(0, 0, 3)) -> bytes:
    head = struct.pack("<Q3d3Bd", point_id, *xyz, 1, 2, 3, 0.5)
    return head + struct.pack("<Q", len(track)) + b"".join(struct.pack("<II", *e) for e in track)


def rig(rig_id: int = 1, sensor_type: int = 0, sensor_id: int = 1, num_sensors: int = 1) -> bytes:
    return struct.pack("<IIiI", rig_id, num_sensors, sensor_type, sensor_id)


def frame(frame_id: int, image_id: int, rig_id: int = 1, qw: float = 1.0) -> bytes:
    return struct.pack("<II7dIiIQ", frame_id, rig_id, qw, 0, 0, 0, 0, 0, 0, 1, 0, 1, image_id)


def listed(*records: bytes) -> bytes:
    return struct.pack("<Q", len(records)) + b"".join(records)


BINARY = {
    "cameras.bin": listed(camera()),
    "images.bin": listed(image(1, (10, 10, 5), (20, 20, NO_POINT)), image(2, (11, 11, 5))),
    "points3D.bin": listed(point(5, (1, 0), (2, 0))),
    "rigs.bin": listed(rig()),
    "frames.bin": listed(frame(1, 1), frame(2, 2)),
}
HUGE = struct.pack("<Q", 10**15)

# File, its new content, complaint.
CORRUPT_BINARY = [
    ("cameras", b"", "byte 0: expected the number of cameras .8 bytes., found the end .* after 0"),
    ("cameras", listed(), "byte 0: expected a camera, found 0"),
    ("cameras", HUGE + camera(), "byte 0: expected at most 1 cameras in the 56 .*found 1000000000"),
    (
        "cameras",
        listed(camera())[:-8],
        "byte 32: expected camera parameters .32 bytes., .* after 24",
    ),
    (
        "cameras",
        listed(camera()) + b"\0",
        "byte 64: expected the end of the file, found 1 more byte",
    ),
    ("cameras", listed(camera(model=18)), "byte 12: camera 1: .* model id from 0 to 17, found 18"),
    (
        "cameras",
        listed(camera(params=(500, 0, 1, 1))),
        "byte 32: camera 1: .*focal.*parameter 1 .*0",
    ),
    (
        "cameras",
        listed(camera(params=(5, 5, 1, NAN))),
        "byte 32: camera 1: .*finite.*parameter 3 .*n",
    ),
    (
        "cameras",
        listed(camera(2**32 - 1)),
        "byte 8: expected a camera id below 4294967295, found 42",
    ),
    (
        "cameras",
        listed(camera(), camera()),
        "byte 64: expected each camera once, found camera 1 aga",
    ),
    ("cameras", listed(camera(3)), "rigs.bin: byte 8: rig 1: expected a camera .*, found camera 1"),
    ("images", listed(), "byte 0: expected an image, found 0"),
    (
        "images",
        BINARY["images.bin"][:-1],
        "byte 196: expected at most 0 keypoints of image 2 in the",
    ),
    ("images", listed(image(1))[:75], "byte 0: expected at most 0 images in the 67 bytes"),
    (
        "images",
        listed(image(1, name=b"a" * 90)[:-20]),
        "byte 72: image 1: .*zero byte, found the end",
    ),
    (
        "images",
        listed(image(1)[:-8] + HUGE),
        "byte 74: .* 0 keypoints of image 1 in the 0 bytes .* 1",
    ),
    ("images", listed(image(1, name=b"\xe9")), r"byte 72: image 1: .* in UTF-8 .*, found '\\xe9'"),
    ("images", listed(image(1, pose=(0,) * 7)), "byte 12: image 1: expected a quaternion .*norm 0"),
    (
        "images",
        listed(image(1, pose=(1, 0, 0, 0, 0, 0, NAN))),
        "byte 12: image 1: .*finite pose.*nan",
    ),
    ("images", listed(image(1, (1, INFINITY, 5))), "byte 82: image 1, keypoint 0: .* found 1 inf"),
    (
        "images",
        listed(image(1), image(1)),
        "byte 82: expected each image once, found image 1 again",
    ),
    (
        "images",
        listed(image(1, (1, 1, 5), (2, 2, 6)), image(2, (1, 1, 5))),
        "byte 106: image 1, keypoint 1: expected a point with .*, found point 6",
    ),
    ("points3D", HUGE, "byte 0: expected at most 0 points in the 0 bytes .*found 1000000000000000"),
    (
        "points3D",
        BINARY["points3D.bin"][:-1],
        "byte 51: expected at most 1 track elements in the 15",
    ),
    (
        "points3D",
        BINARY["points3D.bin"] + b"junk",
        "byte 75: .*end of the file, found 4 more bytes",
    ),
    ("points3D", listed(point(2**63)), "byte 8: expected a point id below 2.63, found 922337203"),
    (
        "points3D",
        listed(point(5, xyz=(0, NAN, 0))),
        "byte 16: point 5: .*finite position.* 0 nan 0",
    ),
    (
        "points3D",
        listed(point(5, (1, 0), (3, 0))),
        "byte 67: point 5: .*in the track, found image 3",
    ),
    (
        "points3D",
        listed(point(5, (1, 7))),
        "byte 59: point 5: expected one of 2 keypoints .* 7",
    ),
    (
        "points3D",
        listed(point(5, (1, 0), (2, 0), (1, 0))),
        "byte 75: point 5: .*once.*keypoint 0 of",
    ),
    ("points3D", listed(), "images.bin: byte 82: image 1, keypoint 0: .*, found point 5"),
    ("points3D", listed(point(5, (1, 0), (2, 0)), point(5)), "byte 75: expected each point once"),
    (
        "rigs",
        b"\1",
        "byte 0: expected the number of rigs .8 bytes., found the end of the file after 1",
    ),
    ("rigs", listed(rig(sensor_type=2)), "byte 16: rig 1: expected sensor type 0 .*, found 2"),
    (
        "rigs",
        listed(rig(num_sensors=2**32 - 1)),
        "byte 12: expected at most 1 sensors of rig 1 in t",
    ),
    ("rigs", listed(), "frames.bin: byte 8: frame 1: expected a rig of the model, found rig 1"),
    ("rigs", listed(rig(), rig()), "byte 24: expected each rig once, found rig 1 again"),
    ("frames", listed(frame(1, 1), frame(2, 3)), "byte 92: frame 2: expected an image .* image 3"),
    ("frames", listed(frame(1, 1, rig_id=9)), "byte 8: frame 1: expected a rig .*, found rig 9"),
    (
        "frames",
        listed(frame(1, 1, qw=0.0)),
        "byte 16: frame 1: expected a quaternion .*, found norm 0",
    ),
    (
        "frames",
        listed(frame(1, 1)),
        "images.bin: byte 130: image 2: expected a frame that holds it",
    ),
]


@pytest.mark.parametrize(("stem", "content", "expected"), CORRUPT_BINARY)
def test_corrupt_binary(tmp_path: Path, stem: str, content: bytes, expected: str) -> None:
    files = {**BINARY, f"{stem}.bin": content}
    if expected.startswith("byte"):
        expected = f"{stem}.bin: {expected}"
    assert re.match(expected, complaint(write_files(tmp_path / "m", files)))


LEGAL_BINARY = {
    "rigs and frames": BINARY,
    "neither": {name: data for name, data in BINARY.items() if name[0] not in "rf"},
    "empty name": {
        **BINARY,
        "images.bin": listed(image(1, (1, 1, 5), name=b""), image(2, (1, 1, 5))),
    },
    "several points, not sorted": {
        **BINARY,
        "images.bin": listed(image(2, (1, 1, 7), (2, 2, 5)), image(1, (3, 3, 5))),
        "points3D.bin": listed(point(7, (2, 0)), point(5, (1, 0), (2, 1)), point(6)),
    },
}


@pytest.mark.parametrize("name", LEGAL_BINARY)
def test_legal_binary(tmp_path: Path, name: str) -> None:
    folder = write_files(tmp_path / "model", LEGAL_BINARY[name])
    assert fields(colmap.load(folder).to_pycolmap()) == fields(pycolmap.Reconstruction(folder))


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D", "rigs", "frames"])
def test_every_truncation_is_noticed(tmp_path: Path, stem: str) -> None:
    folder = write_files(tmp_path / "model", BINARY)
    whole = BINARY[f"{stem}.bin"]
    for size in range(len(whole)):
        (folder / f"{stem}.bin").write_bytes(whole[:size])
        assert complaint(folder)
