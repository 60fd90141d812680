"""The checker of COLMAP files: every corruption is named with its line, nothing legal is refused.

pycolmap itself is the oracle for what is legal.
"""

import os
import re
from pathlib import Path

import pycolmap
import pytest

from bundle import InputError
from bundle.io import colmap
from tests.io.colmap_models import complaint, fields, synthesize, write_files, write_model

CAMERAS = """# comment
1 PINHOLE 640 480 500 501 320 240
"""
IMAGES = """1 1 0 0 0 0 0 0 1 a.jpg
10 10 5 20 20 -1
2 1 0 0 0 1 0 0 1 b.jpg
11 11 5 21 21 -1
"""
POINTS = """5 0 0 3 1 2 3 0.5 1 0 2 0
"""
RIGS = """1 1 CAMERA 1
"""
FRAMES = """1 1 1 0 0 0 0 0 0 1 CAMERA 1 1
2 1 1 0 0 0 1 0 0 1 CAMERA 1 2
"""
TEXT = {"cameras.txt": CAMERAS, "images.txt": IMAGES, "points3D.txt": POINTS}
TEXT_WITH_RIGS = {**TEXT, "rigs.txt": RIGS, "frames.txt": FRAMES}


# File, text in it, text instead, complaint.
CORRUPT_TEXT = [
    ("cameras", "1 PINHOLE", "x PINHOLE", "2: expected a camera id .*, found 'x'"),
    ("cameras", "1 PINHOLE", "-1 PINHOLE", "2: expected a camera id .*, found '-1'"),
    (
        "cameras",
        "1 PINHOLE",
        "4294967295 PINHOLE",
        "2: expected a camera id .*, found '4294967295'",
    ),
    ("cameras", "PINHOLE", "PINHOLES", "2: camera 1: expected the name .* model, found 'PINHOLES'"),
    ("cameras", "640", "640.5", "2: expected an image width .*, found '640.5'"),
    ("cameras", "480", "-480", "2: expected an image height .*, found '-480'"),
    ("cameras", " 240", "", "2: camera 1: expected 4 parameters of PINHOLE, found 3"),
    ("cameras", " 240", " 240 0", "2: expected the end of the line, found '0'"),
    (
        "cameras",
        "500",
        "0",
        "2: camera 1: expected a focal length above 0 as parameter 0 .*found 0",
    ),
    ("cameras", "501", "-501", "2: .* focal length above 0 as parameter 1 of PINHOLE, found -501"),
    ("cameras", "320", "nan", r"2: expected a camera parameter \(a finite number\), found 'nan'"),
    ("cameras", "320", "1e999", "2: expected a camera parameter .*, found '1e999'"),
    ("cameras", "320", "3,2", "2: expected a camera parameter .*, found '3,2'"),
    ("cameras", "500", "1e-999", "2: camera 1: expected a focal length above 0 .*, found 0"),
    ("cameras", CAMERAS, CAMERAS * 2, "4: expected each camera once, found camera 1 again"),
    ("cameras", CAMERAS, "# nothing\n", "1: expected a camera, found 0"),
    ("cameras", CAMERAS, "", "1: expected a camera, found 0"),
    ("cameras", "1 PINHOLE", "2 PINHOLE", "images.txt:1: image 1: expected a camera .*camera 1"),
    ("images", "1 1 0 0 0 0 0 0 1 a", "1 0 0 0 0 0 0 0 1 a", "1: image 1: .*quaternion.*norm 0"),
    ("images", "1 1 0 0 0 0 0 0 1 a", "1 1 0 0 0 inf 0 0 1 a", "1: expected TX .*, found 'inf'"),
    ("images", "1 1 0 0 0 0 0 0 1 a.jpg", "1 1 0 0", "1: expected QZ, found the end of the line"),
    ("images", " a.jpg", "", "1: expected an image name, found the end of the line"),
    ("images", "a.jpg", "a\0.jpg", r"1: image 1: expected a name in UTF-8 .*, found 'a\\x00.jpg'"),
    ("images", "1 b.jpg", "7 b.jpg", "3: image 2: expected a camera of the model, found camera 7"),
    ("images", "2 1 0", "1 1 0", "3: expected each image once, found image 1 again"),
    ("images", "20 20 -1", "20 20", "2: expected the point id of a keypoint, found the end"),
    ("images", "20 20 -1", "20", "2: expected the y of a keypoint, found the end of the line"),
    ("images", "20 20 -1", "20 20 5.5", "2: expected the point id of a keypoint .*, found '5.5'"),
    ("images", "20 20 -1", "20 20 -2", "2: expected a point id, or -1 without a point, found -2"),
    ("images", "10 10 5", "nan 10 5", "2: expected the x of a keypoint .*, found 'nan'"),
    ("images", "10 10 5 20 20 -1", "# no", "2: expected the x of a keypoint .*, found '#'"),
    ("images", "20 20 -1", "20 20 7", "2: image 1, keypoint 1: expected a point .*found point 7"),
    ("images", "11 11 5", "11 11 -1", "points3D.txt:1: point 5: .*keypoint 0 of image 2.*no point"),
    (
        "images",
        "\n11 11 5 21 21 -1\n",
        "",
        "3: image 2: expected a line of keypoints .*end of the f",
    ),
    ("images", IMAGES, "", "1: expected an image, found 0"),
    ("points3D", "5 0 0", "-5 0 0", "1: expected a point id .*, found '-5'"),
    ("points3D", "5 0 0", "9223372036854775808 0 0", "1: expected a point id .*, found '922337"),
    ("points3D", "0 0 3", "0 inf 3", "1: expected Y .*, found 'inf'"),
    (
        "points3D",
        "1 2 3",
        "1 256 3",
        r"1: expected G \(a whole number from 0 to 255\), found '256'",
    ),
    ("points3D", "1 2 3", "1 2 -3", "1: expected B .*, found '-3'"),
    ("points3D", "0.5", "error", "1: expected an error .*, found 'error'"),
    (
        "points3D",
        "2 0",
        "2",
        "1: expected a keypoint index in the track, found the end of the line",
    ),
    ("points3D", "2 0", "3 0", "1: point 5: expected an image .* in the track, found image 3"),
    (
        "points3D",
        "2 0",
        "2 2",
        "1: point 5: .* 2 keypoints of image 2 in the track, found keypoint 2",
    ),
    (
        "points3D",
        "2 0",
        "2 1",
        "1: point 5: expected keypoint 1 of image 2 .* back.*found no point",
    ),
    (
        "points3D",
        "2 0",
        "2 0 2 0",
        "1: point 5: .*each keypoint once .*keypoint 0 of image 2 again",
    ),
    ("points3D", " 2 0", "", "images.txt:4: image 2, keypoint 0: expected a point .*found point 5"),
    (
        "points3D",
        POINTS,
        "",
        "images.txt:2: image 1, keypoint 0: expected a point .*, found point 5",
    ),
    (
        "points3D",
        POINTS,
        POINTS + "6 0 0 0 0 0 0 0 1 0\n",
        "2: point 6: .* back to it, found point 5",
    ),
    (
        "points3D",
        POINTS,
        POINTS + "5 1 1 1 0 0 0 0\n",
        "2: expected each point once, found point 5 ag",
    ),
    ("rigs", "1 1 CAMERA 1", "1 1 CAMERA 2", "1: rig 1: expected a camera .*, found camera 2"),
    ("rigs", "CAMERA", "LIDAR", r"1: expected a sensor type \(CAMERA or IMU\), found 'LIDAR'"),
    (
        "rigs",
        "1 1 CAMERA 1",
        "1 2 CAMERA 1",
        "1: expected a sensor type, found the end of the line",
    ),
    (
        "rigs",
        "1 1 CAMERA 1",
        "1 2 CAMERA 1 CAMERA 1 0",
        "1: rig 1: .*sensor once, found camera 1 ag",
    ),
    ("rigs", "1 1 CAMERA 1", "1 2 CAMERA 1 IMU 1 2", "1: expected HAS_POSE .*, found '2'"),
    ("rigs", "1 1 CAMERA 1", "1 2 CAMERA 1 IMU 1 1 0 0 0 0 1 1 1", "1: rig 1, sensor 1: .*norm 0"),
    ("rigs", RIGS, RIGS * 2, "2: expected each rig once, found rig 1 again"),
    ("rigs", RIGS, "", "frames.txt:1: frame 1: expected a rig of the model, found rig 1"),
    ("frames", "CAMERA 1 2", "CAMERA 1", "2: expected a datum id, found the end of the line"),
    ("frames", "CAMERA 1 2", "CAMERA 1 3", "2: frame 2: expected an image .*, found image 3"),
    (
        "frames",
        "CAMERA 1 2",
        "CAMERA 1 1",
        "2: frame 2: expected each image in one frame.*image 1 ag",
    ),
    ("frames", "CAMERA 1 2", "IMU 1 2", "2: frame 2: expected a sensor of rig 1, found IMU 1"),
    ("frames", "2 1 1 0", "2 1 0 0", "2: frame 2: expected a quaternion .*, found norm 0"),
    ("frames", "2 1 1 0", "1 1 1 0", "2: expected each frame once, found frame 1 again"),
    (
        "frames",
        FRAMES,
        FRAMES[:31],
        "images.txt:3: image 2: expected a frame that holds it, found 0",
    ),
    ("frames", FRAMES, "", "images.txt:1: image 1: expected a frame that holds it, found 0"),
]


@pytest.mark.parametrize(("stem", "old", "new", "expected"), CORRUPT_TEXT)
def test_corrupt_text(tmp_path: Path, stem: str, old: str, new: str, expected: str) -> None:
    file = f"{stem}.txt"
    assert old in TEXT_WITH_RIGS[file]
    with_rigs = stem in ("rigs", "frames")
    files = dict(TEXT_WITH_RIGS if with_rigs else TEXT)
    files[file] = files[file].replace(old, new, 1)
    if not expected.startswith(("cameras", "images", "points3D", "rigs", "frames")):
        expected = f"{file}:{expected}"
    assert re.match(
        expected.replace(".txt", r"\.txt"), complaint(write_files(tmp_path / "m", files))
    )


def swapped(file: str, old: str, new: str, files: dict[str, str] = TEXT) -> dict[str, str]:
    assert old in files[file]
    return {**files, file: files[file].replace(old, new)}


LEGAL_TEXT = {
    "rigs and frames": TEXT_WITH_RIGS,
    "empty rigs and frames": {**TEXT, "rigs.txt": "", "frames.txt": "# none\n"},
    "Windows line ends": {name: text.replace("\n", "\r\n") for name, text in TEXT.items()},
    "spaces at both ends": {name: f"  {text.strip()}  \n" for name, text in TEXT.items()},
    "no newline at the end": {name: text.rstrip("\n") for name, text in TEXT.items()},
    "tabs and double spaces": {
        name: text.replace(" 1 ", "  1\t") for name, text in TEXT_WITH_RIGS.items()
    },
    "blank lines between images": swapped("images.txt", "\n2 1", "\n\n \n# next\n2 1"),
    "blank line for no keypoints": {
        **TEXT,
        "images.txt": IMAGES.replace("11 11 5 21 21 -1", ""),
        "points3D.txt": POINTS.replace(" 2 0", ""),
    },
    "no points": {
        **TEXT,
        "images.txt": IMAGES.replace(" 5 ", " -1 "),
        "points3D.txt": "",
    },
    "a point without a track": swapped("points3D.txt", "5 0 0", "6 0 0 3 1 2 3 -1\n5 0 0"),
    "a keypoint of the same image twice": {
        **TEXT,
        "images.txt": IMAGES.replace("20 20 -1", "20 20 5"),
        "points3D.txt": POINTS.replace("1 0", "1 1 1 0"),
    },
    "signs and exponents": swapped("cameras.txt", "500 501 320", "+5e2 501. 1e-999"),
    "a camera nobody uses": swapped("cameras.txt", "# comment", "9 FOV 0 0 1 1 0 0 0"),
    "ids from 0": {
        "cameras.txt": CAMERAS.replace("1 PINHOLE", "0 PINHOLE"),
        "images.txt": IMAGES.replace("0 1 a", "0 0 a")
        .replace("0 1 b", "0 0 b")
        .replace("1 1 0", "0 1 0", 1)
        .replace(" 5 ", " 0 "),
        "points3D.txt": POINTS.replace("5 0 0", "0 0 0").replace("0.5 1 0", "0.5 0 0"),
    },
    "the largest ids": {
        "cameras.txt": CAMERAS.replace("1 PINHOLE", "4294967294 PINHOLE"),
        "images.txt": IMAGES.replace("0 1 a", "0 4294967294 a")
        .replace("0 1 b", "0 4294967294 b")
        .replace("1 1 0", "4294967294 1 0", 1)
        .replace(" 5 ", f" {2**63 - 1} "),
        "points3D.txt": POINTS.replace("5 0 0", f"{2**63 - 1} 0 0").replace(
            "0.5 1 0", "0.5 4294967294 0"
        ),
    },
    "equal names": swapped("images.txt", "a.jpg", "b.jpg"),
    "names of other alphabets": swapped("images.txt", "a.jpg", "фото/写真#1.jpg"),
    "a frame without data": swapped(
        "frames.txt", "1 1 1 0", "7 1 1 0 0 0 0 0 0 0\n1 1 1 0", TEXT_WITH_RIGS
    ),
    "a rig without sensors": {**TEXT_WITH_RIGS, "rigs.txt": RIGS + "2 0\n"},
    "quaternions that are not normalised": swapped("images.txt", "1 1 0 0 0", "1 2 0 0 0.5"),
}


@pytest.mark.parametrize("name", LEGAL_TEXT)
def test_legal_text(tmp_path: Path, name: str) -> None:
    folder = write_files(tmp_path / "model", LEGAL_TEXT[name])
    assert fields(colmap.load(folder).to_pycolmap()) == fields(pycolmap.Reconstruction(folder))


MODELS = [model for name, model in pycolmap.CameraModelId.__members__.items() if name != "INVALID"]


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_every_camera_model_is_known(
    tmp_path: Path, model: pycolmap.CameraModelId, binary: bool
) -> None:
    source = pycolmap.Reconstruction()
    made = pycolmap.Camera.create_from_model_id(1, model, 500.0, 640, 480)
    source.add_camera_with_trivial_rig(made)
    source.add_image_with_trivial_frame(
        pycolmap.Image(name="a.jpg", camera_id=1, image_id=1), pycolmap.Rigid3d()
    )
    folder = write_model(source, tmp_path / "model", binary=binary)
    problem = colmap.load(folder)
    assert problem.camera_models == (model.name,)
    assert problem.camera_params[0].tolist() == made.params.tolist()

    for index in made.focal_length_idxs():
        params = made.params.copy()
        params[index] = 0.0
        source.camera(1).params = params.tolist()
        folder = write_model(source, tmp_path / f"focal{index}", binary=binary)
        assert f"focal length above 0 as parameter {index} of {model.name}" in complaint(folder)


def test_folder_that_is_no_model(tmp_path: Path) -> None:
    assert complaint(tmp_path / "nothing").endswith(
        "expected the folder of a COLMAP model, found no such path"
    )
    folder = write_files(tmp_path / "partial", {"cameras.bin": b"", "points3D.txt": b""})
    assert complaint(folder) == (
        ": expected the files of a COLMAP model, found no images.bin, points3D.bin (binary) and no "
        "cameras.txt, images.txt (text)"
    )
    (folder / "file").touch()
    assert complaint(folder / "file").endswith("found no folder")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_file_that_may_not_be_read(tmp_path: Path) -> None:
    folder = write_files(tmp_path / "model", TEXT)
    (folder / "images.txt").chmod(0)
    assert complaint(folder) == "images.txt: expected a readable file, found: Permission denied"


def test_path_that_is_not_printable(tmp_path: Path) -> None:
    folder = write_files(tmp_path / "two\nlines", {**TEXT, "cameras.txt": "x"})
    with pytest.raises(InputError, match=r"two\\x0alines/cameras\.txt:1: expected a camera id"):
        colmap.load(folder)


def test_long_and_binary_tokens_are_shortened(tmp_path: Path) -> None:
    folder = write_files(
        tmp_path / "model", {**TEXT, "cameras.txt": b"\xff\x07" + b"A" * 5000 + b" X"}
    )
    message = complaint(folder)
    assert message.startswith("cameras.txt:1: expected a camera id")
    assert r"'\xff\x07AAA" in message
    assert len(message) < 200


def test_synthetic_models_of_both_formats_pass(tmp_path: Path) -> None:
    for seed in range(3):
        source = synthesize(seed, model="OPENCV")
        for binary in (True, False):
            folder = write_model(source, tmp_path / f"{seed}-{binary}", binary=binary)
            assert colmap.load(folder).num_images == 10
