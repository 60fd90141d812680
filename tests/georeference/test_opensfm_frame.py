"""GPS positions and control points of OpenSfM's folder, and its frame after an alignment."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.georeference.gps_positions import read_opensfm_gps
from bundle.georeference.local_frame import LocalFrame
from tests.georeference import blocks

LLA = {"latitude": 46.8425, "longitude": -91.9942, "altitude": 198.5}
REFERENCE = LocalFrame(*LLA.values())


def project(folder, *, dop=0.5, reference=True, with_points=False):
    """An OpenSfM project of a flight, in a model frame of its own, with exact GPS about LLA."""
    made = blocks.block(num_targets=10, seed=3)
    bundle.save(made.problem, folder, "opensfm")
    path = folder / "reconstruction.json"
    (content,) = json.loads(path.read_text())
    assert "reference_lla" not in content  # unknown: zeros would be a place in the sea
    for name, enu in zip(made.problem.image_names, made.cameras, strict=True):
        content["shots"][name] |= {"gps_position": enu.tolist(), "gps_dop": dop}
    if reference:
        content["reference_lla"] = LLA
    path.write_text(json.dumps([content]))
    if with_points:
        (folder / "ground_control_points.json").write_text(json.dumps(points_of(made)))
    return made


def points_of(made):
    """The control points in OpenSfM's JSON: normalised measurements, latitudes, longitudes."""
    points = []
    for point, enu in zip(made.gcps, made.surveyed, strict=True):
        latitude, longitude, height = REFERENCE.to_geodetic(enu)[0].tolist()
        seen = [
            {
                "shot_id": m.image,
                "projection": ((np.array([m.x, m.y]) - [1000, 750]) / 2000).tolist(),
            }
            for m in point.measurements
        ]
        seen.append({"shot_id": "gone.jpg", "projection": [0.1, 0.2]})
        position = {"latitude": latitude, "longitude": longitude, "altitude": height}
        points.append({"id": point.name, "position": position, "observations": seen})
    points[0]["role"] = "metrics_only"
    points.append({"id": "tie", "observations": []})
    return {"points": points}


def test_positions_are_about_the_reference(tmp_path) -> None:
    made = project(tmp_path / "sfm")
    found = read_opensfm_gps(tmp_path / "sfm")
    assert found.names == made.problem.image_names
    np.testing.assert_allclose(REFERENCE.to_enu(found.geodetic), made.cameras, atol=1e-6)
    assert (found.accuracy == 0.5).all()
    path = tmp_path / "sfm" / "reconstruction.json"
    (content,) = json.loads(path.read_text())
    del content["reference_lla"]
    first, *others = content["shots"].values()
    first["gps_dop"] = 999999.0  # OpenSfM's mark for a shot without a fix
    del others[0]["gps_position"]
    path.write_text(json.dumps([content]))
    with pytest.raises(bundle.InputError, match="expected reference_lla, the origin"):
        read_opensfm_gps(path)
    (path.parent / "reference_lla.json").write_text(json.dumps(LLA))
    fewer = read_opensfm_gps(path)
    assert len(fewer) == len(found) - 2 and "1 shot without a GPS fix" in fewer.notes[0]


@pytest.mark.parametrize("what", ["gps", "gcps"])
def test_an_alignment_writes_the_new_reference(tmp_path, what) -> None:
    made = project(tmp_path / "sfm", with_points=True)
    aligned = bundle.align(tmp_path / "sfm", **{what: tmp_path / "sfm"})
    assert aligned.similarity.scale == pytest.approx(blocks.TRUTH.scale, rel=1e-6)
    if what == "gcps":
        assert [point.role for point in aligned.control_points][:2] == ["check", "control"]
        assert max(aligned.rms("check")) < 1e-4
    lost = bundle.save(aligned.problem, tmp_path / "out", "opensfm")
    assert not any("reference_lla" in sentence for sentence in lost)
    (content,) = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    reference = content["reference_lla"]
    assert reference["latitude"] == pytest.approx(aligned.origin.latitude, abs=1e-12)
    assert reference != LLA
    again = bundle.load(tmp_path / "out")
    written = [content["shots"][name]["gps_position"] for name in again.image_names]
    np.testing.assert_allclose(written, again.projection_centers, atol=1e-4)
    new = LocalFrame(*reference.values())
    there = new.to_geodetic(again.projection_centers)
    np.testing.assert_allclose(REFERENCE.to_enu(there), made.cameras, atol=1e-4)


def test_a_move_without_an_origin_drops_the_reference(tmp_path) -> None:
    project(tmp_path / "sfm")
    other = blocks.block(num_targets=10, seed=3).problem
    aligned = bundle.align(tmp_path / "sfm", to=other.replace(points=2 * other.points))
    lost = bundle.save(aligned.problem, tmp_path / "out", "opensfm")
    assert any("reference_lla and gps_position" in sentence for sentence in lost)
    (content,) = json.loads((tmp_path / "out" / "reconstruction.json").read_text())
    assert "reference_lla" not in content
    assert all(
        "gps_position" not in shot and shot["gps_dop"] == 0.5 for shot in content["shots"].values()
    )


def test_a_refinement_with_positions_of_the_project(tmp_path, capsys) -> None:
    made = project(tmp_path / "sfm", with_points=True)
    source, out = str(tmp_path / "sfm"), tmp_path / "out"
    words = ["refine", source, "-o", str(out), "--gps", source, "--gcp", source, "--quiet"]
    assert main(words) == 0, capsys.readouterr().err
    (content,) = json.loads((out / "reconstruction.json").read_text())
    new = LocalFrame(*content["reference_lla"].values())
    there = new.to_geodetic(bundle.load(out).projection_centers)
    np.testing.assert_allclose(REFERENCE.to_enu(there), made.cameras, atol=1e-3)
    kept = tmp_path / "kept"
    assert main(["refine", source, "-o", str(kept), "--refine", "poses", "--quiet"]) == 0
    (content,) = json.loads((kept / "reconstruction.json").read_text())
    assert content["reference_lla"] == LLA  # the frame of the input


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda p: p["points"][1]["position"].pop("latitude"),
            r"position: .*member latitude",
        ),
        (lambda p: p["points"][1].pop("id"), r"points\[1\]: expected a member id"),
        (lambda p: p["points"][1]["observations"][0].update(projection=[1]), "2 finite numbers"),
        (lambda p: p["points"][1].update(observations=3), "expected an array"),
        (lambda p: p.update(points=[]), "expected points with a position"),
        (
            lambda p: p["points"][1]["observations"].append(p["points"][1]["observations"][0]),
            "one measurement of a point per image",
        ),
    ],
)
def test_bad_control_points(tmp_path, damage, message) -> None:
    made = project(tmp_path / "sfm")
    points = points_of(made)
    damage(points)
    path = tmp_path / "ground_control_points.json"
    path.write_text(json.dumps(points))
    with pytest.raises(bundle.InputError, match=message) as caught:
        bundle.align(tmp_path / "sfm", gcps=path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_a_folder_without_control_points(tmp_path) -> None:
    project(tmp_path / "sfm")
    with pytest.raises(bundle.InputError, match=r"expected ground_control_points.json or gcp_list"):
        bundle.align(tmp_path / "sfm", gcps=tmp_path / "sfm")


def test_json_of_another_program_gets_the_forms_that_are_read(tmp_path) -> None:
    path = tmp_path / "lla.json"
    path.write_text(json.dumps({"a.jpg": [46.8, -92.0, 198.3]}))
    with pytest.raises(bundle.InputError, match=r"OpenSfM's reconstructions, or a table \(CSV\)"):
        read_opensfm_gps(path)
