"""`bundle refine --gcp` from the outside."""

import json

import numpy as np
import pytest

import bundle
from bundle.georeference.local_frame import LocalFrame
from tests.cli.test_align import written
from tests.georeference.flights import flight
from tests.printed import table

TARGETS = [
    (-22, -20, 0.5), (21, -22, -0.4), (-20, 23, 0.2), (22, 21, -0.6), (0, 2, 0.8), (-2, -15, -0.9)
]  # fmt: skip


@pytest.fixture
def made(tmp_path):
    """A COLMAP model in a frame of its own, and control points in UTM zone 32."""
    scene = flight(TARGETS, num_images=9, num_points=60, start_noise=0.05)
    bundle.save(scene.elsewhere(), f"{tmp_path}/model/")
    written(tmp_path / "gcp_list.txt", scene.gcps)
    return tmp_path, scene


def refine(run, folder, *words):
    return run(
        "refine",
        folder / "model",
        "-o",
        f"{folder}/out/",
        "--json",
        folder / "r.json",
        "--verbose",
        *words,
    )


def place_of(folder):
    return json.loads((folder / "out" / "georeference.json").read_text())


def test_two_tables_give_the_numbers_of_the_list(run, made):
    folder, _ = made
    listed = folder / "gcp_list.txt"
    points, marks = folder / "points.csv", folder / "marks.csv"
    known = bundle.georeference.read_gcp_list(listed)
    rows = [",".join([one.name, *map(repr, one.position)]) for one in known]
    points.write_text("\n".join([str(known[0].reference_system), "label,x,y,z", *rows]))
    seen = [(one.name, *mark[:3]) for one in known for mark in one.measurements]
    marks.write_text("\n".join(f"{image},{name},{x!r},{y!r}" for name, image, x, y in seen))
    answers = []
    for given in (listed, f"{points},{marks}"):
        code, _, _ = refine(run, folder, "--gcp", given, "--threads", "1")
        assert code == 0
        model = bundle.load(folder / "out")
        answers.append((place_of(folder), model.cam_from_world.tolist(), model.points.tolist()))
    assert answers[0] == answers[1]
    code, _, err = refine(run, folder, "--gcp", points)
    assert code == 2 and "points.csv: line 2: " in err and "POINTS,MARKS" in err
    code, _, err = refine(run, folder, "--gcp", f"{marks},{points}")
    assert code == 2 and "or titles such as label,latitude,longitude,height" in err


def test_a_model_is_adjusted_to_its_control_points(run, made, backend):
    folder, scene = made
    gcps = folder / "gcp_list.txt"
    words = ("--gcp", gcps, "--gcp-sigma", "0.03/0.05", "--check-points", "t4,t5")
    code, out, _ = refine(run, folder, *words, "--gcp-pixel-sigma", "0.7", "--backend", backend)
    assert code == 0
    place, report = place_of(folder), json.loads((folder / "r.json").read_text())
    assert report["georeference"] == place
    assert report["options"]["gauge"] == "NONE"
    problem, refined = bundle.load(folder / "model"), bundle.load(folder / "out")
    np.testing.assert_array_equal(refined.point_ids, problem.point_ids)
    assert refined.num_observations == problem.num_observations
    known = bundle.georeference.gcp_priors(
        problem, gcps, gcp_sigma=(0.03, 0.05), gcp_pixel_sigma=0.7, check_points=["t4", "t5"]
    )
    expected = bundle.solve(problem, priors=known.priors, backend=backend)
    np.testing.assert_allclose(refined.points, expected.problem.points, atol=1e-6)
    assert place["similarity"]["scale"] == pytest.approx(expected.similarity.scale)
    assert place["notes"] == list(known.notes)
    roles = [point["role"] for point in place["gcps"]]
    assert roles == ["control"] * 4 + ["check"] * 2
    assert place["gps"] == []
    assert place["origin"]["longitude"] == pytest.approx(9, abs=1e-3)
    # The coordinates that the file speaks of are those of the model.
    system = bundle.georeference.ReferenceSystem("EPSG:32632")
    survey = [np.add(gcp.position, (500000, 5000000, 100)) for gcp in scene.gcps]
    enu = LocalFrame(**place["origin"]).to_enu(system.to_geodetic(np.array(survey)))
    placed = [gcp.position for gcp in known.control_points]
    np.testing.assert_allclose(placed, enu, atol=1e-6)
    for point, there in zip(place["gcps"], expected.control_points, strict=True):
        np.testing.assert_allclose(point["residual_enu"], there.residual, atol=1e-6)
        assert point["residual_px"] == pytest.approx(there.pixels, rel=1e-6)
        assert point["sigma"] == [0.03, 0.03, 0.05]
        assert len(point["images"]) == there.num_images
        assert not point["suspect"]
        assert np.abs(point["residual_enu"]).max() < 0.2
    for kind, key in (("control", "rms_enu"), ("check", "rms_enu_check")):
        rows = [p["residual_enu"] for p in place["gcps"] if p["role"] == kind]
        np.testing.assert_allclose(place[key], np.sqrt(np.mean(np.square(rows), axis=0)))
    rows = table(out)
    for point in place["gcps"]:
        assert rows[point["name"]][0] == point["role"]
        assert rows[point["name"]][2:5] == [f"{value:+.3f}" for value in point["residual_enu"]]
        assert rows[point["name"]][5] == "0.03/0.05"
        assert rows[point["name"]][-1] == f"{point['residual_px']:.4f}"
    assert max(map(len, out.splitlines())) <= 100


def test_a_list_is_the_reference_of_a_comparison(run, made):
    folder, _ = made
    code, out, _ = run("evaluate", folder / "model", "--reference", folder / "gcp_list.txt")
    assert code == 0 and out.startswith("A differs from 6 surveyed points")


def test_a_georeferenced_model_is_judged_where_it_is(run, made):
    """The errors of ``refine`` at its check points, which no alignment has made smaller."""
    folder, scene = made
    checks = [scene.gcps[1].name, scene.gcps[4].name]
    listed = folder / "gcp_list.txt"
    refine(run, folder, "--gcp", listed, "--check-points", ",".join(checks))
    expected = {one["name"]: one["residual_enu"] for one in place_of(folder)["gcps"]}
    lines = listed.read_text().splitlines(keepends=True)
    marks = [line for line in lines[1:] if line.split()[6] in checks]
    alone, marked = folder / "alone.txt", folder / "marked.txt"
    alone.write_text("".join([lines[0], *marks]))
    marked.write_text("".join([lines[0], *(line.replace("\n", " check\n") for line in marks)]))
    for given, flags in ((listed, ["--align", "none"]), (alone, []), (marked, [])):
        done = run("evaluate", folder / "out", "--reference", given, *flags, "--json", "-")
        found = json.loads(done.out)
        assert found["kind"] == "check" and found["num_shared"] == 2
        for point in found["check_points"]:
            np.testing.assert_allclose(point["error_enu"], expected[point["name"]], atol=1e-6)
    controls = folder / "controls.txt"
    controls.write_text("".join(line for line in lines if line not in marks))
    done = run("evaluate", folder / "out", "--reference", controls, "--align", "none")
    assert "too small" in done.out and "4 surveyed points" in done.out
    for given, flags, words in (
        (listed, ["--align", "none"], "for --align none"),
        (marked, [], "for check points only"),
        (listed, ["--align", "yaw"], "--align: expected one of similarity, none"),
    ):
        done = run("evaluate", folder / "model", "--reference", given, *flags)
        assert done.code == 2 and words in done.err and done.err.count("error") == 1
    away = folder / "away.txt"
    away.write_text(marked.read_text().replace("EPSG:32632", "LOCAL").replace(".jpg", ".png"))
    done = run("evaluate", folder / "out", "--reference", away)
    assert done.code == 2 and "expected check points in 2 images of A" in done.err


def test_beside_positions_of_images(run, made):
    folder, scene = made
    centers = np.add(scene.truth.projection_centers, (500000, 5000000, 100))
    rows = [
        f"{name} {x!r} {y!r} {z!r}"
        for name, (x, y, z) in zip(scene.truth.image_names, centers.tolist(), strict=True)
    ]
    (folder / "geo.txt").write_text("\n".join(["EPSG:32632", *rows]))
    words = ("--gps", folder / "geo.txt", "--gps-sigma", "1", "--check-points", "t0,t1,t2,t3,t4")
    code, out, _ = refine(run, folder, "--gcp", folder / "gcp_list.txt", *words)
    assert code == 0
    place = place_of(folder)
    assert len(place["gps"]) == 9 and all(entry["used"] for entry in place["gps"])
    assert [point["role"] for point in place["gcps"]] == ["check"] * 5 + ["control"]
    assert np.abs([entry["residual_enu"] for entry in place["gps"]]).max() < 1
    assert np.abs(place["gcps"][0]["residual_enu"]).max() < 1
    shown = table(out)
    assert "9 of 9 images" in shown["positions"][0]
    assert {"rms control", "rms check", "rms"} <= set(shown)


@pytest.mark.parametrize("loss", ["trivial", "tukey"])
def test_a_gross_error_is_named(run, made, loss):
    folder, scene = made
    x, y, z = scene.gcps[2].position
    object.__setattr__(scene.gcps[2], "position", (x + 3.5, y, z))
    wrong = written(folder / "wrong.txt", scene.gcps)
    code, out, _ = refine(run, folder, "--gcp", wrong, "--prior-loss", loss)
    assert code == 0
    place = place_of(folder)
    assert [point["name"] for point in place["gcps"] if point["suspect"]] == ["t2"]
    assert place["gcps"][2]["residual_leave_one_out_enu"][0] == pytest.approx(-3.5, abs=0.4)
    assert table(out)["t2"][0] == "suspect"
    assert any(line.startswith("- t2 is probably wrong") for line in out.splitlines())
    if loss == "tukey":
        assert place["gcps"][2]["residual_enu"][0] == pytest.approx(-3.5, abs=0.2)
        others = [point["residual_enu"] for point in place["gcps"] if point["name"] != "t2"]
        assert np.abs(others).max() < 0.2


def test_a_real_list(run, bundle_data, tmp_path):
    folder = bundle_data / "georeferenced" / "copr_gcp"
    words = ("-o", f"{tmp_path}/out/", "--gcp", folder / "gcp_list.txt", "--gcp-sigma", "0.5")
    code, _, _ = run("refine", folder / "model", *words, "--prior-loss", "tukey", "--quiet")
    assert code == 0
    place = place_of(tmp_path)
    gcps = {point["name"]: point for point in place["gcps"]}
    assert [name for name, point in gcps.items() if point["suspect"]] == ["gcp06"]
    assert gcps["gcp06"]["residual_enu"][0] < -2.5
    assert {name for name, point in gcps.items() if point["role"] == "unused"} == {"gcp00", "gcp01"}
    assert place["reference_system"].startswith("+proj=utm")


def test_squares_begin_where_an_alignment_ends(run, bundle_data, tmp_path):
    folder = bundle_data / "georeferenced" / "copr_gcp"
    words = ("-o", f"{tmp_path}/out/", "--gcp", folder / "gcp_list.txt", "--gcp-sigma", "0.5")
    code, _, _ = run("refine", folder / "model", *words, "--quiet")
    assert code == 0
    place = place_of(tmp_path)
    # The model is stiff beside a sigma of half a metre, and the solve stops after a few steps.
    np.testing.assert_allclose(place["rms_enu"], [1.393, 0.921, 0.050], atol=0.005)
    assert [point["name"] for point in place["gcps"] if point["suspect"]] == ["gcp06"]


def test_what_is_odd_is_noted(run, made):
    folder, _ = made
    text = (folder / "gcp_list.txt").read_text()
    lines = text.splitlines()
    words = lines[1].split()
    words[3] = "2105.5"  # beyond the 2000 pixels of the image
    lines[1] = "\t".join(words)
    lines.append(f"500100\t5000100\t100\t5\t5\t{words[5]}\tlonely")
    lines.append(f"{words[0]}\t{words[1]}\t{words[2]}\t5\t5\tnowhere.jpg\tt0")
    lines = [line.replace(line.split()[2], "nan") if "t3" in line else line for line in lines]
    (folder / "odd.txt").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    code, out, _ = refine(run, folder, "--gcp", folder / "odd.txt")
    assert code == 0
    place = place_of(folder)
    notes = "\n".join(place["notes"])
    assert f"t0 is measured outside of {words[5]} (2000 x 1500 px), at 2106 " in notes
    assert "lonely is not used: measured in 1 " in notes
    assert "1 measurement of" in notes
    gcps = {point["name"]: point for point in place["gcps"]}
    assert gcps["lonely"]["role"] == "unused"
    assert gcps["t3"]["residual_enu"][2] is None and gcps["t3"]["sigma"][2] is None
    assert "0.02/-" in out


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--gcp-sigma", "1"], ["--gcp-sigma", "only with --gcp"]),
        (["--gcp-pixel-sigma", "1"], ["--gcp-pixel-sigma", "only with --gcp"]),
        (["--check-points", "t1"], ["--check-points", "only with --gcp"]),
        (["--gcp", "GCPS", "--gcp-sigma", "a"], ["--gcp-sigma", "metres"]),
        (["--gcp", "GCPS", "--gcp-pixel-sigma", "0"], ["--gcp-pixel-sigma"]),
        (["--gcp", "GCPS", "--gps-sigma", "2"], ["--gps-sigma", "only with --gps"]),
        (["--gcp", "GCPS", "--images", "."], ["--images", "only with --gps", "or --html"]),
        (["--gcp", "GCPS", "--check-points", "t99"], ["--check-points", "t99"]),
        (["--gcp", "GCPS", "--check-points", "t0,t1,t2,t3"], ["--gcp", "at least 3", "found 2"]),
        (["--gcp", "GCPS", "--prior-loss-scale", "2"], ["--prior-loss-scale", "trivial"]),
        (["--gcp", "GCPS", "--refine", "points"], ["--gcp", "poses"]),
        (["--gcp", "GCPS", "--only-images", "1"], ["--gcp", "--only-images"]),
        (["--gcp", "nowhere.txt"], ["nowhere.txt"]),
    ],
)
def test_wrong_flags_are_one_line_and_nothing_is_written(run, made, words, expected):
    folder, _ = made
    named = [str(folder / "gcp_list.txt") if word == "GCPS" else word for word in words]
    code, out, err = refine(run, folder, *named)
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ") and all(word in line for word in expected), line
    assert {path.name for path in folder.iterdir()} == {"model", "gcp_list.txt"}


def on_a_line(lines):
    """Every target on one northing and one height."""
    rows = [line.split() for line in lines]
    return ["\t".join([x, "5000000", "100", *rest]) for x, _, _, *rest in rows]


def two_targets(lines):
    return [line for line in lines if line.endswith(("t0", "t1"))]


def one_image_each(lines):
    return list({line.split()[-1]: line for line in lines}.values())


def of_other_images(lines):
    return [line.replace(".jpg", ".tif") for line in lines]


@pytest.mark.parametrize(
    ("change", "header", "expected"),
    [
        (on_a_line, "EPSG:32632", ["control points", "line"]),
        (two_targets, "EPSG:32632", ["--gcp", "at least 3", "found 2"]),
        (one_image_each, "EPSG:32632", ["--gcp", "at least 3", "found 0", "measured in 1"]),
        (of_other_images, "EPSG:32632", ["--gcp", "at least 3", "found 0"]),
        (list, "EPSG:99999999", ["line 1", "EPSG:99999999"]),
    ],
)
def test_wrong_lists_are_one_line_and_nothing_is_written(run, made, change, header, expected):
    folder, _ = made
    lines = (folder / "gcp_list.txt").read_text().splitlines()[1:]
    (folder / "gcp_list.txt").write_text("\n".join([header, *change(lines)]))
    code, out, err = refine(run, folder, "--gcp", folder / "gcp_list.txt")
    assert (code, out) == (2, "")
    line = err.splitlines()[-1]
    assert line.startswith("error: ") and all(word in line for word in expected), line
    assert {path.name for path in folder.iterdir()} == {"model", "gcp_list.txt"}


def test_a_gauge_beside_control_points_is_held_and_warned_of(run, made):
    folder, _ = made
    code, _, _ = refine(run, folder, "--gcp", folder / "gcp_list.txt", "--gauge", "two-cameras")
    assert code == 0
    summary = json.loads((folder / "r.json").read_text())["summary"]
    assert "gauge_beside_factors" in summary["warning_kinds"]


def test_a_resumed_run_ends_as_the_uninterrupted_one(run, made):
    folder, _ = made
    words = ("--gcp", folder / "gcp_list.txt", "--deterministic", "--threads", "1", "--rounds", "2")
    checkpoint = folder / "run.npz"
    every = ("--checkpoint-interval", "2")
    code, _, _ = refine(run, folder, *words, "--checkpoint", checkpoint, *every)
    assert code == 0
    expected, place = bundle.load(folder / "out"), place_of(folder)
    # A run that has ended is resumed at its end, another one from its last checkpoint.
    code, _, _ = refine(run, folder, *words, "--resume", checkpoint, *every)
    assert code == 0
    np.testing.assert_array_equal(bundle.load(folder / "out").points, expected.points)
    assert place_of(folder) == place
    words = (*words[:2], "--gcp-sigma", "0.5", *words[2:])
    code, _, err = refine(run, folder, *words, "--resume", checkpoint, *every)
    assert code == 2 and "run.npz" in err


def test_heights_of_two_systems_are_named_and_estimated(run, made):
    folder, scene = made
    problem = bundle.load(folder / "model")
    known = bundle.georeference.gcp_priors(problem, folder / "gcp_list.txt")
    placed = bundle.solve(problem, priors=known.priors)
    higher = placed.problem.projection_centers + np.array([0, 0, 40])
    geodetic = known.origin.to_geodetic(higher)
    lines = [
        f"{name} {longitude:.10f} {latitude:.10f} {height:.4f}"
        for name, (latitude, longitude, height) in zip(problem.image_names, geodetic, strict=True)
    ]
    (folder / "geo.txt").write_text("\n".join(["EPSG:4326", *lines]) + "\n")
    words = ["--gcp", folder / "gcp_list.txt", "--gps", folder / "geo.txt", "--gps-sigma", "0.05"]
    code, out, error = refine(run, folder, *words)
    assert code == 0, error
    report = json.loads((folder / "r.json").read_text())
    found = {one["kind"]: one for one in report["findings"]}["gps_offset"]
    assert code == 0 and "above the control points" in out
    assert found["command"].endswith("--gps-offset up")
    offset = report["georeference"]["offset"]
    assert offset["value"][:2] == [0, 0] and offset["p"] < 1e-9
    assert offset["value"][2] == pytest.approx(40, abs=4 * offset["sigma"][2])
    bent = abs(found["evidence"]["focal_length"] - scene.problem.camera_params[0, 0])
    sigma = found["evidence"]["focal_length_sigma"]
    right = found["evidence"]["focal_length_with_offset"]
    assert sigma > 0 and abs(right - scene.problem.camera_params[0, 0]) < 4 * sigma
    code, out, _ = refine(run, folder, *words, "--gps-offset", "up", "--overwrite")
    report = json.loads((folder / "r.json").read_text())
    assert code == 0 and "estimated" in out
    assert "gps_offset" not in {one["kind"] for one in report["findings"]}
    assert report["georeference"]["offset"]["value"][2] == pytest.approx(
        offset["value"][2], rel=1e-3
    )
    up = [one["residual_enu"][2] for one in report["georeference"]["gps"]]
    assert np.abs(up).max() < 0.2
    refined = bundle.load(folder / "out")
    right = abs(refined.camera_params[0, 0] - scene.problem.camera_params[0, 0])
    assert bent > 10 * right and refined.num_images == problem.num_images
    again = (folder / "out" / "georeference.json").read_text()
    assert json.loads(again)["offset"] == report["georeference"]["offset"]


def test_an_offset_needs_control_points_and_a_solve(run, made):
    folder, _ = made
    (folder / "geo.txt").write_text("EPSG:4326\na 1 2 3\n")
    code, _, error = refine(run, folder, "--gps", folder / "geo.txt", "--gps-offset", "up")
    assert code == 2 and "--gps-offset" in error and "--gcp" in error
    words = ["--gps", folder / "geo.txt", "--gcp", folder / "gcp_list.txt", "--gps-offset", "all"]
    code, _, error = run("align", folder / "model", "-o", f"{folder}/out/", *words)
    assert code == 2 and "--gps-offset" in error and not (folder / "out").exists()
