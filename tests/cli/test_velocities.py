"""`bundle refine --velocities` from the outside, and the commands that look at its result."""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.similarity import Similarity, moved
from tests.campaigns.rolling_shutter import make
from tests.georeference.test_velocity_priors import RATE, priors_of, velocity_text

SHUTTER = ("--rolling-shutter", "rows", "--readout", "0.02", "--frame-rate", RATE)
POSES = ("--refine", "poses,points")


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A model of a drone's film in a frame of its own, with geo.txt and velocities."""
    folder = tmp_path_factory.mktemp("flight")
    made = make(1, 5, rolling_shutter=0.6, num_images=16, num_points=300)
    truth, given = made.ground_truth, made.problem
    shutter = truth.rolling_shutter.replace(frame_rate=RATE)
    truth = truth.replace(rolling_shutter=shutter)
    names = tuple(f"image{image}.jpg" for image in truth.image_ids.tolist())
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    start = moved(given.replace(rolling_shutter=None), Similarity(0.3, turn, np.ones(3)))
    bundle.save(start.replace(image_names=names), folder / "model", "colmap")
    frame = LocalFrame.about(np.array([[50.0, 8.0, 300.0]]))
    noise = 0.05 * np.random.default_rng(2).standard_normal((truth.num_images, 3))
    places = frame.to_geodetic(truth.projection_centers + noise)
    rows = [f"{n} {x!r} {y!r} {z!r}" for n, (y, x, z) in zip(names, places.tolist(), strict=True)]
    (folder / "geo.txt").write_text("\n".join(["EPSG:4326", *rows]) + "\n")
    named = dict(zip(truth.image_ids.tolist(), names, strict=True))
    (folder / "velocities.csv").write_text(velocity_text(priors_of(truth, 0.1), named.__getitem__))
    return folder, truth


def refine(run, flight, tmp_path, *words):
    folder, _ = flight
    return run(
        "refine", folder / "model", "-o", tmp_path / "out", "--json", tmp_path / "r.json",
        "--overwrite", *POSES, *words,
    )  # fmt: skip


GPS = ("--gps", "geo.txt", "--gps-sigma", "0.05")


def given(flight, *words):
    files = {"geo.txt", "velocities.csv", "frames.csv"}
    return [flight[0] / word if word in files else word for word in words]


def test_twists_follow_the_velocities(run, flight, tmp_path, backend):
    words = given(flight, *SHUTTER, *GPS, "--velocities", "velocities.csv", "--backend", backend)
    code, out, err = refine(run, flight, tmp_path, *words)
    assert code == 0, err
    assert "Velocities of 16 images" in out
    report = json.loads((tmp_path / "r.json").read_text())["velocities"]
    assert len(report["images"]) == 16
    assert {"image", "x", "y", "z", "sigmas"} == set(report["images"][0])
    assert 0 < report["rms_sigmas"] < 1
    found = bundle.load(tmp_path / "out")
    assert found.rolling_shutter.frame_rate == RATE
    errors = found.rolling_shutter.twist - flight[1].rolling_shutter.twist
    assert np.sqrt((errors[:, 3:] ** 2).mean()) < 0.01
    plain = refine(run, flight, tmp_path, *given(flight, *SHUTTER, *GPS))
    assert plain.code == 0
    worse = bundle.load(tmp_path / "out").rolling_shutter.twist
    before = np.sqrt(((worse - flight[1].rolling_shutter.twist)[:, 3:] ** 2).mean())
    assert before > 0.03
    assert "velocities" not in json.loads((tmp_path / "r.json").read_text())


def test_the_antenna_moves_with_the_camera(run, flight, tmp_path):
    """An arm of 3 m, given wrongly, is a wrong speed w x arm of the camera."""
    twists = []
    for antenna in ("0,0,0", "3,0,0"):
        words = (*SHUTTER, "--velocities", "velocities.csv", "--antenna", antenna, *GPS)
        assert refine(run, flight, tmp_path, *given(flight, *words)).code == 0
        twists.append(bundle.load(tmp_path / "out").rolling_shutter.twist)
    without, found = twists
    arm = np.cross(found[:, :3], [3.0, 0, 0])
    assert np.abs(arm).max() > 1e-3
    np.testing.assert_allclose(found[:, 3:] + arm, without[:, 3:], atol=0.5 * np.abs(arm).max())


def test_later_commands_know_the_frame_and_the_rate(run, flight, tmp_path):
    words = given(flight, *SHUTTER, *GPS, "--velocities", "velocities.csv")
    assert refine(run, flight, tmp_path, *words).code == 0
    model, file = tmp_path / "out", flight[0] / "velocities.csv"
    again = run("refine", model, "-o", tmp_path / "again", *POSES, "--velocities", file)
    assert again.code == 0, again.err
    assert "Velocities of 16 images" in again.out
    for command in (
        ("covariance", model, "-o", tmp_path / "c.npz"),
        ("diagnose", model),
        ("report", model, "-o", tmp_path / "r.html"),
    ):
        done = run(*command, "--velocities", file)
        assert done.code == 0, done.err
    done = run("validate", model, "--folds", "2", "--velocities", file)
    assert done.code == 0, done.err


def test_a_readout_from_velocities(run, flight, tmp_path):
    folder, truth = flight
    rows = [f"{k},{t}" for k, t in zip(truth.image_ids, truth.rolling_shutter.frames, strict=True)]
    (folder / "frames.csv").write_text("\n".join(["image_id,frame", *rows]) + "\n")
    code, _, err = refine(
        run, flight, tmp_path, *given(flight, *GPS, "--velocities", "velocities.csv"),
        "--rolling-shutter", "rows", "--readout", "estimate", "--frame-rate", RATE, "--twists",
        "tied", "--twist-sigma", "0.0005,0.012", "--frames", folder / "frames.csv",
    )  # fmt: skip
    assert code == 0, err
    camera = json.loads((tmp_path / "r.json").read_text())["rolling_shutter"]["cameras"][0]
    assert abs(camera["readout"] - 0.6) < 4 * camera["readout_sigma"] < 2


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((*GPS, "--velocities", "velocities.csv"), ["--velocities", "rolling shutter"]),
        (
            ("--rolling-shutter", "rows", "--readout", "0.6", *GPS, "--velocities",
             "velocities.csv"),
            ["--velocities", "--frame-rate"],
        ),
        (
            ("--rolling-shutter", "rows", "--frame-rate", "30", *GPS, "--velocities",
             "velocities.csv"),
            ["--velocities", "readout"],
        ),
        ((*SHUTTER, "--velocities", "velocities.csv"), ["--velocities", "--gps"]),
        ((*SHUTTER, *GPS, "--velocities", "nowhere.csv"), ["nowhere.csv"]),
        ((*SHUTTER, *GPS, "--velocities", "xmp"), ["--velocities xmp", "--images DIR"]),
        (
            (*SHUTTER, *GPS, "--velocities", "velocities.csv", "--images", "."),
            ["--images"],
        ),
        ((*SHUTTER, *GPS, "--velocity-sigma", "1"), ["--velocity-sigma", "--velocities"]),
        (
            (*SHUTTER, *GPS, "--velocities", "velocities.csv", "--velocity-sigma", "0"),
            ["--velocity-sigma", "0"],
        ),
        (
            (*SHUTTER, *GPS, "--velocities", "velocities.csv", "--twists", "hard"),
            ["--twists"],
        ),
        ((*SHUTTER, *GPS, "--velocities", "velocities.csv", "--refine", "points"), ["poses"]),
    ],
)  # fmt: skip
def test_wrong_flags_are_one_line(run, flight, tmp_path, words, expected):
    code, out, err = refine(run, flight, tmp_path, *given(flight, *words))
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    assert all(word in line for word in expected), line
    assert not (tmp_path / "out").exists()
