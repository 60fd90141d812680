"""ROS bags and videos of a rendered flight give the tracks of its folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.errors import InputError
from tests.inertial.images.other_forms import frames, write_bag, write_kalibr, write_video
from tests.inertial.images.rendered_flight import SMALL, Flight, render

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def mav(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second and a half of a flight, and its calibration as Kalibr writes it."""
    folder = tmp_path_factory.mktemp("flight")
    mav = render(Flight(duration=1.4, **SMALL), folder)
    write_kalibr(mav)
    return mav


def files(mav: Path) -> list[Path]:
    return [mav.parent / name for name in ("camchain-imucam.yaml", "imu.yaml")]


@pytest.fixture(scope="module")
def expected(mav: Path) -> bundle.TrackedImages:
    """The tracks of the folder."""
    return bundle.track_images(mav, calibration=files(mav))


@pytest.mark.parametrize(
    ("ros", "settings"),
    [
        (1, {}),
        (2, {}),
        (1, {"encoding": "bgr8"}),
        (2, {"encoding": "rgba8"}),
        (2, {"encoding": "png"}),
        (1, {"with_stamps": False}),
        (1, {"cameras": ("/cam0/image_raw", "/cam1/image_raw")}),
    ],
)
def test_a_bag_gives_the_tracks_of_the_folder(
    mav: Path, expected: bundle.TrackedImages, tmp_path: Path, ros: int, settings: dict[str, Any]
) -> None:
    path = write_bag(mav, tmp_path / ("flight.bag" if ros == 1 else "flight"), ros, **settings)
    tracked = bundle.track_images(path, calibration=files(mav))
    for name in ("gyro", "accel", "imu_timestamps_ns", "track_timestamps_ns", "track_ids"):
        np.testing.assert_array_equal(
            getattr(tracked.sequence, name), getattr(expected.sequence, name)
        )
    np.testing.assert_array_equal(tracked.sequence.xy, expected.sequence.xy)
    notes = " ".join(tracked.tracking.notes)
    assert "/cam0/image_raw and /imu0" in notes
    assert ("times of receipt" in notes) == ("with_stamps" in settings)


def test_topics_that_are_not_unique(mav: Path, tmp_path: Path, capsys: Capture) -> None:
    path = write_bag(mav, tmp_path / "two.bag", 1, cameras=("/left", "/right"))
    words = ["vio", str(path), "-o", str(tmp_path / "x.tum"), "--quiet"]
    for file in files(mav):
        words += ["--calibration", str(file)]
    for more, expected in (
        ([], ("--image-topic /left or /right",)),
        (["--image-topic", "/up"], ("--image-topic:", "/left, /right", "/up")),
        (["--image-topic", "/left", "--imu-topic", "/left"], ("--imu-topic:", "/imu0")),
        (["--imu", "x.csv"], ("--imu:", "valid only with a video")),
    ):
        assert main([*words, *more]) == 2
        err = capsys.readouterr().err
        assert all(word in err for word in expected), err
    assert main(["info", str(path), "--image-topic", "/left", "--quiet", *words[5:]]) == 0
    capsys.readouterr()


def test_damaged_and_foreign_bags(mav: Path, tmp_path: Path) -> None:
    whole = write_bag(mav, tmp_path / "whole.bag", 1).read_bytes()
    cut = tmp_path / "cut.bag"
    for content in (whole[: len(whole) // 2], whole[:13], whole[:200]):
        cut.write_bytes(content)
        with pytest.raises(InputError, match=r"cut\.bag: expected a whole ROS bag"):
            bundle.track_images(cut, calibration=files(mav))
    folder = write_bag(mav, tmp_path / "folder", 2)
    with pytest.raises(InputError, match=r"camera: expected --calibration FILE"):
        bundle.track_images(folder)
    for path in folder.glob("*.db3"):
        path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(InputError, match="expected a whole ROS bag"):
        bundle.track_images(folder, calibration=files(mav))
    empty = write_bag(mav, tmp_path / "empty.bag", 1, cameras=())
    with pytest.raises(InputError, match=r"Image .*found /imu0"):
        bundle.track_images(empty, calibration=files(mav))


@pytest.fixture(scope="module")
def video(mav: Path) -> Path:
    """The frames as a video, its IMU in seconds from the first frame, and frame times."""
    return write_video(mav)


def test_a_video_gives_nearly_the_tracks_of_the_folder(
    mav: Path, expected: bundle.TrackedImages, video: Path
) -> None:
    seconds = bundle.track_images(video, calibration=files(mav), imu=mav.parent / "flight_imu.csv")
    absolute = bundle.track_images(
        video, calibration=files(mav), imu=mav / "imu0/data.csv",
        frame_times=mav.parent / "frame_times.txt",
    )  # fmt: skip
    for tracked in (seconds, absolute):
        found = tracked.tracking
        assert found.num_images == expected.tracking.num_images
        assert found.num_tracks == pytest.approx(expected.tracking.num_tracks, rel=0.1)
        assert found.check.unexplained < 0.1
    first = absolute.sequence.track_timestamps_ns[0]
    assert first == frames(mav)[0][0]
    assert seconds.sequence.track_timestamps_ns[0] == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda given: given.pop("imu"), "--imu FILE"),
        (lambda given: given.update(frame_times="one"), "expected the times of 26 frames"),
        (lambda given: given.update(path="text"), "video"),
        (lambda given: given.update(imu="absolute"), "between the IMU samples"),
        (lambda given: given.update(path="missing.mp4"), "images and IMU samples"),
        (lambda given: given.update(image_topic="/a"), "valid only with a ROS bag"),
    ],
)
def test_videos_that_lack_something(
    mav: Path, video: Path, tmp_path: Path, change: Callable[[Any], Any], words: str
) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    given: dict[str, Any] = {
        "path": video, "calibration": files(mav), "imu": mav.parent / "flight_imu.csv"
    }  # fmt: skip
    change(given)
    if given.get("imu") == "absolute":
        given["imu"] = mav / "imu0/data.csv"
    if given.get("frame_times") == "one":
        given["frame_times"] = tmp_path / "one.txt"
        given["frame_times"].write_text("0.5\n")
    if given["path"] == "text":
        given["path"] = tmp_path / "text.mp4"
    with pytest.raises(InputError, match=words):
        bundle.track_images(given.pop("path"), **given)


def test_a_truncated_video(mav: Path, video: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.avi"
    shutil.copy(video, cut)
    with cut.open("r+b") as file:
        file.truncate(video.stat().st_size // 2)
    with pytest.raises(InputError, match=r"cut\.avi: "):
        bundle.track_images(cut, calibration=files(mav), imu=mav.parent / "flight_imu.csv")
