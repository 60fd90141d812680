"""`bundle align` from the outside."""

import json

import numpy as np
import pytest

import bundle
from tests.georeference.blocks import block
from tests.printed import table

SHIFT = 0.5  # of the file's pixels


def written(path, gcps, header="EPSG:32632", start=(500000.0, 5000000.0, 100.0)):
    """The control points as a file, about a place in UTM zone 32."""
    lines = [header]
    for point in gcps:
        x, y, z = (f"{value:.9f}" for value in np.array(point.position) + start)
        lines += [
            f"{x}\t{y}\t{z}\t{m.x - SHIFT!r}\t{m.y - SHIFT!r}\t{m.image}\t{point.name}"
            for m in point.measurements
        ]
    path.write_text("\n".join(lines))
    return path


@pytest.fixture
def flight(tmp_path):
    made = block(7, pixel_noise=0.3, survey_noise=0.02)
    bundle.save(made.problem, f"{tmp_path}/model/")
    return tmp_path, made, written(tmp_path / "gcp_list.txt", made.gcps)


def test_a_model_is_written_with_its_georeference(run, flight):
    folder, made, gcps = flight
    words = ("--gcp", gcps, "--check-points", "t2,t4", "--json", folder / "report.json", "--quiet")
    words += ("--verbose",)
    code, out, err = run("align", folder / "model", "-o", f"{folder}/out/", *words)
    assert (code, err) == (0, "")
    expected = bundle.align(made.problem, gcps=gcps, check_points=["t2", "t4"])
    saved = bundle.load(folder / "out")
    np.testing.assert_array_equal(saved.points, expected.problem.points)
    record = json.loads((folder / "out" / "georeference.json").read_text())
    report = json.loads((folder / "report.json").read_text())
    assert report["georeference"] == record and report["command"] == "align"
    assert report["output"] == {"path": f"{folder}/out/", "format": "colmap"}
    assert record["reference_system"] == "EPSG:32632"
    # 500000 east is the central meridian of zone 32, and latitude 45.15 is where the rest leads.
    assert record["origin"]["longitude"] == pytest.approx(9, abs=1e-3)
    assert record["origin"]["latitude"] == pytest.approx(45.1534, abs=1e-3)
    roles = [point["role"] for point in record["gcps"]]
    assert [roles.count(role) for role in ("control", "check")] == [5, 2]
    assert max(record["rms_enu"]) < 0.05 and max(record["rms_enu_check"]) < 0.2
    rows = table(out)
    for point in expected.control_points:
        shown = [f"{value:+.3f}" for value in point.residual]
        assert rows[point.name][-7:-4] == shown and rows[point.name][-1] == f"{point.pixels:.4f}"
    assert max(map(len, out.splitlines())) <= 100


def test_the_report_alone_goes_to_standard_output(run, flight):
    folder, _, gcps = flight
    code, out, _ = run(
        "align", folder / "model", "-o", f"{folder}/out/", "--gcp", gcps, "--json", "-", "--quiet"
    )
    assert code == 0
    assert len(json.loads(out)["georeference"]["gcps"]) == 7


def test_a_suspect_is_named(run, flight):
    folder, made, _ = flight
    x, y, z = made.gcps[3].position
    object.__setattr__(made.gcps[3], "position", (x + 2, y, z))
    wrong = written(folder / "wrong.txt", made.gcps)
    words = ("--gcp", wrong, "--quiet", "--verbose")
    code, out, _ = run("align", folder / "model", "-o", f"{folder}/out/", *words)
    assert code == 0
    assert table(out)["t3"][0] == "suspect"
    (sentence,) = (line for line in out.splitlines() if line.startswith("- t3"))
    assert "east" in sentence


def test_measured_positions_and_another_model(run, flight):
    folder, made, _ = flight
    geo = folder / "geo.txt"
    places = made.cameras + np.array([500000.0, 5000000.0, 100.0])
    rows = [
        f"{n} {x:.6f} {y:.6f} {z:.6f}"
        for n, (x, y, z) in zip(made.problem.image_names, places, strict=True)
    ]
    geo.write_text("\n".join(["WGS84 UTM 32N", *rows]))
    code, out, _ = run("align", folder / "model", "-o", f"{folder}/out/", "--gps", geo, "--quiet")
    assert code == 0
    record = json.loads((folder / "out" / "georeference.json").read_text())
    assert len(record["gps"]) == 9 and all(entry["used"] for entry in record["gps"])
    # The map is 0.9996 of the ground, and flat.
    assert record["similarity"]["scale"] == pytest.approx(3.7 / 0.9996, rel=1e-4)
    assert max(record["rms_enu"]) < 0.01
    assert "9 positions" in out

    words = ("--reference", folder / "out", "--quiet")
    code, _, _ = run("align", folder / "model", "-o", f"{folder}/again/", *words)
    assert code == 0
    there, again = (bundle.load(folder / name) for name in ("out", "again"))
    np.testing.assert_allclose(again.points, there.points, atol=1e-8)
    found = json.loads((folder / "again" / "georeference.json").read_text())
    assert found["origin"] == record["origin"]


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ([], "--gcp"),
        (["--gcp", "none.txt"], "none.txt"),
        (["--gcp", "GCPS", "--gcp-sigma", "a"], "--gcp-sigma"),
        (["--gcp", "GCPS", "--gcp-pixel-sigma", "0"], "--gcp-pixel-sigma"),
        (["--gcp", "GCPS", "--check-points", "t99"], "--check-points"),
        (["--gcp", "GCPS", "--check-points", "t0,t1,t2,t3,t4"], "--gcp"),
        (["--gcp", "GCPS", "--gps-sigma", "-2"], "--gps-sigma"),
        (["--gcp", "GCPS", "--antenna", "1,2"], "--antenna"),
        (["--gcp", "GCPS", "--antenna", "left"], "--antenna"),
        (["--gcp", "GCPS", "--prior-loss", "hubert"], "--prior-loss"),
        (["--gcp", "GCPS", "--prior-loss-scale", "0"], "--prior-loss-scale"),
        (["--gps", "exif"], "--images"),
        (["--gcp", "GCPS", "--reference", "MODEL"], "--reference"),
        (["--gcp", "GCPS", "--gpc", "x"], "--gpc"),
    ],
)
def test_bad_input_ends_in_one_line_and_writes_nothing(run, flight, words, wanted):
    folder, _, gcps = flight
    named = {"GCPS": gcps, "MODEL": folder / "model"}
    before = sorted(folder.rglob("*"))
    code, out, err = run(
        "align",
        folder / "model",
        "-o",
        f"{folder}/out/",
        "--quiet",
        *[named.get(w, w) for w in words],
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: ") and wanted in err
    assert sorted(folder.rglob("*")) == before


def test_files_that_would_be_replaced(run, flight):
    folder, _, gcps = flight
    target = folder / "out" / "georeference.json"
    words = ("align", folder / "model", "-o", f"{folder}/out/", "--gcp", gcps, "--quiet")
    assert run(*words, "--json", target).code == 2 and not target.exists()
    assert run(*words).code == 0
    target.unlink()
    target.mkdir()
    points = (folder / "out" / "points3D.bin").read_bytes()
    code, _, err = run(*words, "--gcp-sigma", "1/9")
    assert code == 2 and "georeference.json" in err
    assert (folder / "out" / "points3D.bin").read_bytes() == points


def test_a_file_without_image_names_is_refused(run, model, flight):
    _, _, gcps = flight
    code, _, err = run("align", model, "-o", model, "--gcp", gcps, "--quiet")
    assert code == 2 and "names" in err
