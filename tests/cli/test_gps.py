"""`bundle refine --gps` from the outside."""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.prior_alignment import ProblemPriors
from tests.georeference.test_exif_gps import photo
from tests.georeference.test_prior_alignment import problem_and_goal
from tests.georeference.test_solve_with_priors import noisy
from tests.printed import table

FRAME = LocalFrame(-33.9, 18.4, 120.0)


@pytest.fixture
def model(tmp_path):
    """A COLMAP model in a frame of its own, and geo.txt with noise of 10 cm."""
    problem, goal = problem_and_goal(noise=0.1)
    bundle.save(problem, tmp_path / "model", "colmap")
    write_geo(tmp_path / "geo.txt", problem.image_names, noisy(goal, 0.1))
    return tmp_path / "model"


def write_geo(path, names, enu):
    rows = zip(names, FRAME.to_geodetic(enu).tolist(), strict=True)
    lines = [f"{name} {lon!r} {lat!r} {h!r}" for name, (lat, lon, h) in rows]
    path.write_text("\n".join(["EPSG:4326", *lines, ""]))


def refine(run, model, *words):
    return run(
        "refine",
        model,
        "-o",
        model.parent / "out",
        "--json",
        model.parent / "r.json",
        "--verbose",
        *words,
    )


def test_a_model_goes_to_its_positions_and_stays(run, model, backend):
    geo = model.parent / "geo.txt"
    code, out, _ = refine(run, model, "--gps", geo, "--gps-sigma", "0.1/0.2", "--backend", backend)
    assert code == 0
    place = json.loads((model.parent / "out" / "georeference.json").read_text())
    report = json.loads((model.parent / "r.json").read_text())
    assert report["georeference"] == place
    assert report["options"]["gauge"] == "NONE"
    assert report["options"]["gps"] == str(geo) and report["options"]["gps_sigma"] == "0.1/0.2"
    assert "gcp" not in report["options"]  # not given
    assert {"reference_system", "origin", "similarity", "gps", "gcps", "rms_enu"} <= set(place)
    assert place["reference_system"] == "EPSG:4326"
    assert place["similarity"]["scale"] == pytest.approx(25, rel=0.05)
    refined, before = bundle.load(model.parent / "out"), bundle.load(model)
    # The coordinates that the file speaks of are those of the model.
    positions = bundle.georeference.read_geo_file(geo)
    enu = LocalFrame(**place["origin"]).to_enu(positions.geodetic)
    residual = refined.projection_centers - enu
    assert [entry["image"] for entry in place["gps"]] == list(refined.image_names)
    assert all(entry["used"] for entry in place["gps"])
    np.testing.assert_allclose([e["residual_enu"] for e in place["gps"]], residual, atol=1e-6)
    np.testing.assert_allclose(place["rms_enu"], np.sqrt((residual**2).mean(axis=0)), atol=1e-6)
    sigmas = np.linalg.norm(residual / [0.1, 0.1, 0.2], axis=1)
    np.testing.assert_allclose([e["sigmas"] for e in place["gps"]], sigmas, rtol=1e-4)
    assert np.abs(residual).max() < 0.5
    # The similarity brings the input near to the output: the solve moved no more than noise does.
    rotation, translation = (
        np.array(place["similarity"][key]) for key in ("rotation", "translation")
    )
    start = place["similarity"]["scale"] * before.projection_centers @ rotation.T + translation
    assert np.abs(start - refined.projection_centers).max() < 1
    rows = table(out)
    assert rows["positions"][0].startswith("8 of 8 images used")
    east, north, up = place["rms_enu"]
    assert rows["rms"][0] == f"{east:.4f} m east, {north:.4f} m north, {up:.4f} m up"


def minutes(angle):
    """Degrees, minutes and seconds."""
    angle = abs(angle)
    return float(int(angle)), float(int(angle * 60) % 60), angle * 3600 % 60


def test_positions_out_of_the_images(run, model):
    problem, goal = problem_and_goal(noise=0.1)
    folder = model.parent / "photos"
    for name, (lat, lon, h) in zip(
        problem.image_names[:6], FRAME.to_geodetic(noisy(goal, 0.1)).tolist(), strict=False
    ):
        tags = {1: "S", 2: minutes(lat), 3: "E", 4: minutes(lon), 5: b"\0", 6: h, 31: 0.5}
        photo(folder / name, tags)
    photo(folder / problem.image_names[6], None)
    code, out, _ = refine(run, model, "--gps", "exif", "--images", folder)
    assert code == 0
    place = json.loads((model.parent / "out" / "georeference.json").read_text())
    assert [entry["used"] for entry in place["gps"]] == [True] * 6 + [False] * 2
    assert place["gps"][7] == {
        "image": "image7.jpg", "residual_enu": [None] * 3, "sigmas": None, "used": False
    }  # fmt: skip
    # The accuracy of the tags is horizontal; the default is the vertical one.
    first = place["gps"][0]
    expected = np.linalg.norm(np.array(first["residual_enu"]) / [0.5, 0.5, 5])
    assert first["sigmas"] == pytest.approx(expected, rel=1e-6)
    missing, silent, without = place["notes"]
    assert "1 image not in" in missing
    assert "1 image without a GPS position" in silent
    assert "2 images of the model without a position: image6.jpg, image7.jpg" in without
    assert "6 of 8 images used" in out


@pytest.mark.parametrize("loss", ["tukey", "trivial"])
def test_a_wrong_position_is_named(run, model, loss):
    geo = model.parent / "geo.txt"
    lines = geo.read_text().splitlines()
    name, lon, *rest = lines[4].split()
    lines[4] = " ".join([name, repr(float(lon) + 3.2e-4), *rest])  # 30 m east
    geo.write_text("\n".join(lines))
    words = ("--gps", geo, "--gps-sigma", "0.1", "--prior-loss", loss)
    code, out, _ = refine(run, model, *words)
    assert code == 0
    place = json.loads((model.parent / "out" / "georeference.json").read_text())
    worst = max(place["gps"], key=lambda entry: entry["sigmas"])
    assert worst["image"] == name
    assert [name, f"{worst['residual_enu'][0]:+.3f}"] in [
        row.split()[:2] for row in out.split("\n")
    ]
    if loss == "tukey":
        assert worst["residual_enu"][0] == pytest.approx(-30, abs=0.7)
        others = [entry["sigmas"] for entry in place["gps"] if entry is not worst]
        assert max(others) < 3


def test_the_antenna_and_other_settings_reach_the_priors(run, model):
    words = ("--gps", model.parent / "geo.txt", "--gps-sigma", "0.1")
    refine(run, model, *words, "--max-iterations", "0")
    plain = json.loads((model.parent / "r.json").read_text())
    refine(run, model, *words, "--max-iterations", "0", "--antenna", "0,-2,1.5")
    moved = json.loads((model.parent / "r.json").read_text())
    problem = bundle.load(model.parent / "out")
    known = ProblemPriors.make(
        problem, bundle.georeference.gps_priors(
            problem, model.parent / "geo.txt", antenna=(0, -2, 1.5)
        ).priors,
    )  # fmt: skip
    found = [entry["residual_enu"] for entry in moved["georeference"]["gps"]]
    np.testing.assert_allclose(found, known.residuals(problem), atol=1e-6)
    assert moved["georeference"]["similarity"] != plain["georeference"]["similarity"]
    loss = ("--prior-loss", "cauchy", "--prior-loss-scale", "0.5", "--max-iterations", "0")
    refine(run, model, *words, *loss)
    robust = json.loads((model.parent / "r.json").read_text())
    squared = np.array([entry["sigmas"] ** 2 for entry in robust["georeference"]["gps"]])
    costs = (0.5 * 0.25 * np.log1p(squared / 0.25)).sum()
    error = robust["reprojection_error"]["after"]
    pixels = 0.5 * error["rmse"] ** 2 * error["num_observations"]
    assert robust["summary"]["final_cost"] == pytest.approx(pixels + costs, rel=1e-9)


def test_beside_an_output_file(run, model):
    out = model.parent / "flat" / "out.txt"
    out.parent.mkdir()
    # BAL's camera model has no principal point, so that only a model with none goes there.
    problem, goal = problem_and_goal(model="RADIAL", noise=0.1)
    flat = problem.replace(
        camera_params=problem.camera_params * [1, 0, 0, 1, 1],
        observation_xy=problem.observation_xy - [400, 300],
    )
    bundle.save(flat, model.parent / "radial", "colmap")
    write_geo(model.parent / "geo.txt", problem.image_names, noisy(goal, 0.1))
    words = ("-o", out, "--format", "bal", "--gps", model.parent / "geo.txt")
    assert run("refine", model.parent / "radial", *words).code == 0
    assert {path.name for path in out.parent.iterdir()} == {"out.txt", "georeference.json"}


def test_a_second_run_replaces_the_first(run, model):
    words = ("--gps", model.parent / "geo.txt", "--gps-sigma", "0.1")
    assert refine(run, model, *words).code == 0
    first = (model.parent / "out" / "georeference.json").read_text()
    again = run("refine", model.parent / "out", "-o", model.parent / "out", *words)
    assert again.code == 0
    second = json.loads((model.parent / "out" / "georeference.json").read_text())
    assert second["similarity"]["scale"] == pytest.approx(1, abs=1e-3)
    assert json.loads(first)["origin"] == second["origin"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--gps-sigma", "2"], ["--gps-sigma", "only with --gps"]),
        (["--antenna", "0,0,0"], ["--antenna", "only with --gps"]),
        (["--images", "."], ["--images", "only with --gps"]),
        (["--prior-loss", "huber"], ["--prior-loss:", "only with --gcp, --gps, --gravity"]),
        (["--gps", "exif"], ["--gps", "--images DIR"]),
        (["--gps", "GEO", "--images", "."], ["--images", "only with --gps exif"]),
        (["--gps", "GEO", "--prior-loss-scale", "2"], ["--prior-loss-scale", "trivial"]),
        (["--gps", "GEO", "--prior-loss", "robust"], ["--prior-loss", "robust"]),
        (["--gps", "GEO", "--prior-loss", "huber", "--prior-loss-scale", "0"], ["-scale:"]),
        (["--gps", "GEO", "--refine", "points"], ["--gps", "poses"]),
        (["--gps", "GEO", "--only-images", "1"], ["--gps", "--only-images"]),
        (["--gps", "GEO", "--gps-sigma", "0"], ["--gps-sigma", "0"]),
        (["--gps", "GEO", "--gps-sigma", "a/b"], ["--gps-sigma", "a/b"]),
        (["--gps", "GEO", "--gps-sigma", "1/2/3"], ["--gps-sigma", "1/2/3"]),
        (["--gps", "GEO", "--antenna", "1,2"], ["--antenna", "X,Y,Z", "1,2"]),
        (["--gps", "GEO", "--antenna", "1,2,nan"], ["--antenna", "finite"]),
        (["--gps", "nowhere.txt"], ["nowhere.txt"]),
        (["--gps", "exif", "--images", "nowhere"], ["nowhere", "folder of the images"]),
        (["--gps", "GEO", "--gps-sigma", ""], ["--gps-sigma"]),
    ],
)  # fmt: skip
def test_wrong_flags_are_one_line_and_nothing_is_written(run, model, words, expected):
    named = [str(model.parent / "geo.txt") if word == "GEO" else word for word in words]
    code, out, err = refine(run, model, *named)
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    assert all(word in line for word in expected), line
    assert {path.name for path in model.parent.iterdir()} == {"model", "geo.txt"}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("EPSG:99999999\nimage0.jpg 1 2\n", ["line 1", "EPSG:99999999"]),
        ("EPSG:4326\nimage0.jpg 1 2\nimage0.jpg 1 2\n", ["line 3", "again"]),
        ("EPSG:4326\nimage0.jpg 1 nan 3\n", ["line 2", "y", "nan"]),
        ("EPSG:4326\nDJI_1.JPG 18 -33 3\n", ["--gps", "at least 3", "found 0", "image0.jpg"]),
        (
            "EPSG:4326\nimage0.jpg 18 -33 3\nimage1.jpg 18.1 -33 3\nx.jpg 18 -33 3\n",
            ["--gps", "at least 3", "found 2"],
        ),
        ("EPSG:4326\n" + "".join(f"image{i}.jpg 18 -33 3\n" for i in range(8)), ["--gps", "line"]),
        ("EPSG:4326\nimage0.jpg 18 -33 3\na/image0.jpg 18 -33 3\n", ["one position for each"]),
    ],
)  # fmt: skip
def test_wrong_files_are_one_line_and_nothing_is_written(run, model, content, expected):
    geo = model.parent / "geo.txt"
    geo.write_text(content)
    code, out, err = refine(run, model, "--gps", geo)
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    assert all(word in line for word in expected), line
    assert {path.name for path in model.parent.iterdir()} == {"model", "geo.txt"}


def test_places_that_georeference_cannot_have(run, model):
    geo, out = model.parent / "geo.txt", model.parent / "out"
    bundle.save(bundle.load(model), out, "colmap")
    (out / "georeference.json").mkdir()
    before = (out / "images.bin").read_bytes()
    code, _, err = run("refine", model, "-o", out, "--gps", geo)
    assert code == 2
    assert "georeference.json" in err.splitlines()[-1]
    assert (out / "images.bin").read_bytes() == before
    (out / "georeference.json").rmdir()
    code, _, err = run(
        "refine", model, "-o", out, "--gps", geo, "--json", out / "georeference.json"
    )
    assert code == 2
    assert "replace" in err.splitlines()[-1]


def test_files_without_names(run, tmp_path):
    from tests.scenes import scene

    bundle.save(scene(), tmp_path / "in.txt")
    write_geo(tmp_path / "geo.txt", ["a.jpg"], np.zeros((1, 3)))
    code, _, err = run(
        "refine", tmp_path / "in.txt", "-o", tmp_path / "out.txt", "--gps", tmp_path / "geo.txt"
    )
    assert code == 2
    assert "--gps: expected images with names" in err
    assert not (tmp_path / "out.txt").exists()


def test_a_fixed_gauge_beside_positions_is_told(run, model):
    words = ("--gps", model.parent / "geo.txt", "--gauge", "two-cameras")
    code, _, _ = refine(run, model, *words)
    assert code == 0
    report = json.loads((model.parent / "r.json").read_text())
    assert "gauge_beside_factors" in report["summary"]["warning_kinds"]


def test_rounds_start_where_the_positions_are(run, model):
    words = ("--gps", model.parent / "geo.txt", "--gps-sigma", "0.1", "--rounds", "2")
    code, _, _ = refine(run, model, *words, "--max-error", "0.2")
    assert code == 0
    report = json.loads((model.parent / "r.json").read_text())
    assert len(report["rounds"]) == 2
    assert report["georeference"]["similarity"]["scale"] == pytest.approx(25, rel=0.05)
    assert max(report["georeference"]["rms_enu"]) < 0.2


def test_covariance_counts_the_positions(run, model):
    geo, out = model.parent / "geo.txt", model.parent / "out"
    words = ["--gps", geo, "--gps-sigma", "0.1/0.2"]
    assert refine(run, model, *words, "--function-tolerance", "1e-12")[0] == 0
    target = model.parent / "c.npz"
    code, printed, _ = run("covariance", out, "-o", target, "--gauge", "none", *words)
    assert code == 0
    assert "lower the cost" not in " ".join(printed.split())
    refined = bundle.load(out)
    priors = bundle.georeference.gps_priors(refined, geo, gps_sigma="0.1/0.2").priors
    expected = bundle.covariance(refined, gauge="none", priors=priors)
    with np.load(target) as found:
        np.testing.assert_allclose(found["pose_covariance"], expected.pose_covariance, rtol=1e-6)
        assert found["dof"] == expected.dof
    # Without them nothing holds the world; from where it was they pull.
    code, _, error = run("covariance", out, "-o", target, "--gauge", "none")
    assert code == 2 and "error: --gauge: " in error
    code, printed, _ = run("covariance", model, "-o", target, *words)
    assert "lower the cost" in " ".join(printed.split())
    code, _, error = run("covariance", out, "-o", target, "--gps-sigma", "2")
    assert code == 2 and "--gps-sigma" in error


def test_diagnosis_counts_the_positions(run, model):
    geo, report = model.parent / "geo.txt", model.parent / "d.json"
    assert run("diagnose", model, "--json", report).code == 0
    alone = json.loads(report.read_text())
    assert (alone["nullity"], alone["expected_nullity"]) == (7, 7)
    assert run("diagnose", model, "--json", report, "--gps", geo, "--gps-sigma", "0.1").code == 0
    held = json.loads(report.read_text())
    assert (held["nullity"], held["expected_nullity"]) == (0, 0)
    # The less certain the positions, the weaker they hold the world.
    assert run("diagnose", model, "--json", report, "--gps", geo, "--gps-sigma", "10").code == 0
    assert json.loads(report.read_text())["condition_number"] > 10 * held["condition_number"]


@pytest.mark.parametrize("command", ["diagnose", "report"])
def test_flags_of_positions_without_them(run, model, command):
    words = () if command == "diagnose" else ("-o", model.parent / "page.html")
    done = run(command, model, *words, "--gps-sigma", "2", "--quiet")
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith("error: --gps-sigma: ") and done.err.count("\n") == 1
    assert not (model.parent / "page.html").exists()


def test_factors_scale_the_sigmas_of_the_file_and_of_the_flag(tmp_path, run, model):
    """A file with some sigmas and factors is the file with the products."""
    lines = (model.parent / "geo.txt").read_text("utf-8").splitlines()

    def written(name, factors, default):
        rows = [lines[0]]
        for k, line in enumerate(lines[1:]):
            first = " ".join(line.split()[:4])
            sigmas = (0.05 * factors[0], 0.2 * factors[1]) if k % 2 else default
            rows.append(first + (f" 0 0 0 {sigmas[0]:.12g} {sigmas[1]:.12g}" if sigmas else ""))
        path = tmp_path / name
        path.write_text("\n".join(rows) + "\n", "utf-8")
        return path

    scaled, plain = tmp_path / "scaled.json", tmp_path / "plain.json"
    geo = written("own.txt", (1, 1), None)
    words = ("--gps", geo, "--gps-sigma", "0.1/0.3", "--gps-sigma-scale", "4/0.5")
    assert refine(run, model, *words, "--json", scaled)[0] == 0
    geo = written("products.txt", (4, 0.5), (0.4, 0.15))
    assert refine(run, model, "--gps", geo, "--json", plain)[0] == 0
    costs = [
        json.loads(path.read_text("utf-8"))["summary"]["final_cost"] for path in (scaled, plain)
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)
    code, _, error = refine(run, model, *words[:-1], "0")
    assert code == 2 and "--gps-sigma-scale" in error


@pytest.mark.parametrize("command", ["align", "covariance", "diagnose"])
def test_factors_are_taken_by_every_command_with_positions(tmp_path, run, model, command):
    words = ["--gps", model.parent / "geo.txt", "--gps-sigma-scale", "3"]
    target = {"align": ["-o", tmp_path / "placed/"], "covariance": ["-o", tmp_path / "c.npz"]}
    if command == "covariance":
        assert refine(run, model, *words[:2])[0] == 0
        model = model.parent / "out"
    done = run(command, model, *target.get(command, ()), *words, "--quiet")
    assert done.code == 0, done.err
