"""`bundle refine --imu` from the outside: files, output in metres with z up, refusals."""

import json
import shutil

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.sequence_folder import save_sequence
from tests.cli.test_gps import write_geo
from tests.inertial.offline.models import model_of
from tests.inertial.offline.test_imu_adjustment import error_of


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A model, its times, and the files of the IMU, with the flight that they come from."""
    folder = tmp_path_factory.mktemp("imu")
    flight = bundle.synthesize_flight(duration=6.0, num_tracks=80, seed=1)
    problem, stamps = model_of(flight.sequence, flight.ground_truth, 6)
    bundle.save(problem, folder / "model", "colmap")
    save_sequence(flight.sequence, folder / "sequence")
    lines = [f"{name},{stamp}" for name, stamp in zip(problem.image_names, stamps, strict=True)]
    (folder / "times.csv").write_text("\n".join(["name,timestamp_ns", *lines]))
    return folder, flight, stamps


@pytest.fixture
def folder(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "files")
    return tmp_path / "files"


def words_of(folder):
    return [
        "--imu", folder / "sequence" / "imu.csv",
        "--frame-times", folder / "times.csv",
        "--calibration", folder / "sequence" / "calibration.yaml",
    ]  # fmt: skip


def refine(run, folder, *words):
    out, report = folder / "out", folder / "r.json"
    return run("refine", folder / "model", "-o", out, "--json", report, *words)


def test_models_are_written_in_metres_with_z_up(run, folder, made):
    _, flight, stamps = made
    words = [*words_of(folder), "--refine", "poses,points", "--imu-noise-scale", "2"]
    code, out, _ = refine(run, folder, *words, "--max-iterations", "40")
    assert code == 0
    assert "In metres, z up" in out
    refined = bundle.load(folder / "out")
    error = error_of(None, refined, stamps, flight.sequence, flight.ground_truth)
    assert error.scale == pytest.approx(1, abs=0.05)
    assert error.rotation_rms < 1.5
    report = json.loads((folder / "r.json").read_text())
    assert report["imu"]["similarity"]["scale"] == pytest.approx(3.7, rel=0.5)
    assert report["options"]["backend"] == "CERES"
    assert refined.num_points == bundle.load(folder / "model").num_points
    assert not [f for f in report["findings"] if f["kind"] == "not_refined"]


def test_a_contradiction_comes_first_and_nothing_is_written(run, folder):
    """Extrinsics that are off by 6 degrees: exit status 1, and a report that names them."""
    path = folder / "sequence" / "calibration.yaml"
    lines = path.read_text().splitlines()
    row = next(k for k, line in enumerate(lines) if line.startswith("camera_from_imu"))
    given = np.array(json.loads(lines[row].partition(":")[2]))
    turned = Rotation.from_euler("y", 6, degrees=True) * Rotation.from_quat(given[:4])
    lines[row] = f"camera_from_imu: {[*turned.as_quat().tolist(), *given[4:].tolist()]}"
    path.write_text("\n".join(lines))
    words = [*words_of(folder), "--refine", "poses,points", "--loss", "cauchy"]
    code, out, _ = refine(run, folder, *words)
    assert code == 1
    assert not (folder / "out").exists()
    report = json.loads((folder / "r.json").read_text())
    assert report["headline"][0].startswith("Not usable: images and IMU contradict each other")
    assert "In metres" not in out
    assert report["summary"]["is_solution_usable"] is False
    first, second = report["findings"][:2]
    assert (first["kind"], first["is_problem"]) == ("imu_contradiction", True)
    assert first["evidence"]["cause"] == second["kind"] == "camera_from_imu"
    assert "imu.csv: line " in first["sentence"]
    found = report["imu"]
    assert found["chi2"] > found["chi2_bound"] > found["chi2_freedom"]
    assert len(found["interval_chi2"]) == found["chi2_freedom"] / 6
    assert 1 / found["noise_scale"] ** 2 <= found["variance_factor"] <= 1


def test_a_leap_of_a_sample_is_named_by_its_line(run, folder):
    path = folder / "sequence" / "imu.csv"
    lines = path.read_text().splitlines()
    words = lines[600].split(",")
    lines[600] = ",".join([words[0], "25.0", *words[2:]])
    path.write_text("\n".join(lines))
    code, _, _ = refine(run, folder, *words_of(folder), "--refine", "poses,points")
    assert code == 0
    first = json.loads((folder / "r.json").read_text())["findings"][0]
    assert (first["kind"], first["is_problem"]) == ("imu_samples", False)
    assert f"{path}: line 601" in first["sentence"]


@pytest.mark.parametrize(("factor", "unit"), [(1000, "microseconds"), (1000000, "milliseconds")])
def test_stamps_in_another_unit_are_named(run, folder, factor, unit):
    for path, column in ((folder / "sequence" / "imu.csv", 0), (folder / "times.csv", 1)):
        head, *lines = path.read_text().splitlines()
        rows = [line.split(",") for line in lines]
        for one in rows:
            one[column] = str(int(one[column]) // factor)
        path.write_text("\n".join([head, *map(",".join, rows)]))
    code, _, err = refine(run, folder, *words_of(folder))
    assert code == 2
    assert unit in err.splitlines()[-1]


def test_positions_and_samples_together(run, folder, made):
    _, flight, stamps = made
    problem = bundle.load(folder / "model")
    states = states_at(flight.ground_truth, stamps)
    arm = np.array(flight.sequence.calibration.camera_from_imu)
    turn = Rotation.from_quat(states[:, :4])
    centers = states[:, 4:7] - turn.apply(Rotation.from_quat(arm[:4]).inv().apply(arm[4:]))
    enu = Rotation.from_euler("z", 1.2).apply(centers)
    enu += 0.02 * np.random.default_rng(1).normal(size=enu.shape)
    write_geo(folder / "geo.txt", problem.image_names, enu)
    words = [*words_of(folder), "--refine", "poses,points", "--imu-noise-scale", "2"]
    words += ["--gps", folder / "geo.txt", "--gps-sigma", "0.02", "--max-iterations", "60"]
    code, out, _ = refine(run, folder, *words)
    assert code == 0 and "In metres, z up" in out
    report = json.loads((folder / "r.json").read_text())
    place = json.loads((folder / "out" / "georeference.json").read_text())
    assert report["georeference"] == place
    given = report["options"]
    assert given["imu"].endswith(".csv") and given["noise_scale"] == 2
    assert given["gps_sigma"] == "0.02"
    assert max(place["rms_enu"]) < 0.1
    refined = bundle.load(folder / "out")
    found = Rotation.from_quat(refined.cam_from_world[:, :4]).apply([0, 0, 1.0])
    expected = (Rotation.from_quat(arm[:4]) * turn.inv()).apply([0, 0, 1.0])
    assert np.degrees(np.linalg.norm(found - expected, axis=1)).max() < 1.5


def test_rounds_and_gravity_together_with_samples(run, folder, made):
    """A planted outlier does not stay; gravity agrees with the samples."""
    _, flight, stamps = made
    start = bundle.load(folder / "model")  # without its points that go behind a camera
    options = {"refine": ("poses", "points"), "loss": "cauchy"}
    problem = bundle.solve_rounds(start, num_rounds=3, max_error=6.0, **options).problem
    xy = np.array(problem.observation_xy)
    xy[::150] += 40
    bundle.save(problem.replace(observation_xy=xy), folder / "wrong", "colmap")
    turn = Rotation.from_quat(states_at(flight.ground_truth, stamps)[:, :4])
    arm = Rotation.from_quat(flight.sequence.calibration.camera_from_imu[:4])
    down = (arm * turn.inv()).apply([0, 0, -1.0])
    lines = [
        f"{name} {x} {y} {z} 1.0"
        for name, (x, y, z) in zip(problem.image_names, down.tolist(), strict=True)
    ]
    (folder / "down.txt").write_text("\n".join(lines))
    code, out, _ = run(
        "refine", folder / "wrong", "-o", folder / "out", "--json", folder / "r.json",
        *words_of(folder), "--refine", "poses,points", "--imu-noise-scale", "2",
        "--rounds", "3", "--max-error", "8", "--gravity", folder / "down.txt", "--loss", "cauchy",
    )  # fmt: skip
    assert code == 0 and "In metres, z up" in out
    report = json.loads((folder / "r.json").read_text())
    assert 1 < len(report["rounds"]) <= 3
    assert report["rounds"][0]["num_observations_removed"] >= len(xy[::150])
    assert report["imu"]["gauge_freedom"] == 4
    assert report["imu"]["chi2"] < report["imu"]["chi2_bound"]  # of the observations kept
    assert report["deleted"]["num_observations"] == (
        problem.num_observations - bundle.load(folder / "out").num_observations
    )


def test_files_that_do_not_fit_are_one_line(run, folder):
    times = folder / "times.csv"
    lines = times.read_text().splitlines()
    first, last = lines[1].split(",")[1], lines[-1].split(",")[1]
    cases = {
        "one missing": ("\n".join(lines[:-1]), "1 image"),
        "not ascending": ("\n".join([*lines[:3], lines[1], *lines[3:]]), "4: expected at least"),
        "empty": ("", "found 0"),
        "no number": ("\n".join([*lines, "x.png,soon"]), "nanoseconds"),
        "outside": (
            "\n".join(lines).replace(f",{last}", f",{int(last) + 10**12}"),
            "--imu: expected images between",
        ),
        "huge": ("\n".join([*lines, f"x.png,{10**19}"]), "nanoseconds"),
        "no overlap": (
            "\n".join(f"{line.split(',')[0]},{10 * k + 1}" for k, line in enumerate(lines[1:])),
            "all images are outside",
        ),
    }  # fmt: skip
    assert first != last
    for text, word in cases.values():
        times.write_text(text)
        code, out, err = refine(run, folder, *words_of(folder))
        line = err.splitlines()[-1]
        assert (code, out) == (2, "") and line.startswith("error: ") and word in line, line
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        (["--only-images", "1-4"], ["--only-images", "--imu"]),
        (["--hold-out", "10"], ["--hold-out", "--imu"]),
        (["--set", "cameras *: f fixed"], ["--set", "--imu"]),
        (["--fix-images", "1"], ["--fix-images", "--imu"]),
        (["--backend", "fused"], ["--imu", "ceres"]),
        (["--gauge", "two_cameras"], ["--imu", "gauge", "two-cameras"]),
        (["--gauge", "three_points"], ["--imu", "gauge", "three-points"]),
        (["--imu-noise-scale", "0"], ["--imu-noise-scale"]),
    ],
)
def test_other_ways_to_refine_are_refused(run, folder, more, expected):
    code, out, err = refine(run, folder, *words_of(folder), *more)
    line = err.splitlines()[-1]
    assert (code, out) == (2, "")
    assert line.startswith("error: ") and all(word in line for word in expected), line


def test_files_need_each_other(run, folder):
    words = words_of(folder)
    for part, word in ((words[:2], "--frame-times"), (words[:4], "--calibration")):
        code, _, err = refine(run, folder, *part)
        assert code == 2 and word in err.splitlines()[-1]
    code, _, err = refine(run, folder, *words[2:])
    assert code == 2 and "only with --imu" in err.splitlines()[-1]
