"""Priors from positions on the earth, and what became of them."""

import json

import numpy as np
import pytest

import bundle
from bundle import InputError
from bundle.georeference.alignment_result import ControlPointError, ImageError
from bundle.georeference.georeferenced import Georeference, rig_notes
from bundle.georeference.gps_positions import GpsPositions, read_geo_file
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.similarity import Similarity
from bundle.georeference.survey_priors import gps_priors
from tests.georeference.blocks import block
from tests.georeference.test_prior_alignment import problem_and_goal
from tests.rig_scenes import rig_problem

FRAME = LocalFrame(46.8, -91.9, 200.0)


def positions(problem, goal, accuracy=np.nan, **changes):
    count = problem.num_images
    settings = {
        "names": problem.image_names,
        "geodetic": FRAME.to_geodetic(goal.projection_centers),
        "accuracy": np.full((count, 2), accuracy),
        "reference_system": "EPSG:4326",
        "source": "here",
    }
    return GpsPositions(**settings | changes)


def test_sigmas_are_those_of_each_position_or_the_default():
    problem, goal = problem_and_goal()
    accuracy = np.array([[0.02, 0.05], [np.nan, 0.07], [0.03, np.nan]] + [[np.nan, np.nan]] * 5)
    known = gps_priors(problem, positions(problem, goal, accuracy=accuracy), gps_sigma="3/7")
    found = [prior.sigma.tolist() for prior in known.priors]
    assert found[:3] == [[0.02, 0.02, 0.05], [3, 3, 0.07], [0.03, 0.03, 7]]
    assert found[3:] == [[3, 3, 7]] * 5
    default = gps_priors(problem, positions(problem, goal)).priors[0]
    assert default.sigma.tolist() == [2, 2, 5]
    assert default.loss == "trivial"


def test_the_frame():
    problem, goal = problem_and_goal()
    given = positions(problem, goal)
    known = gps_priors(problem, given, origin=FRAME)
    found = np.array([prior.position for prior in known.priors])
    np.testing.assert_allclose(found, goal.projection_centers, atol=1e-6)
    middle = gps_priors(problem, given)
    assert middle.origin == LocalFrame.about(given.geodetic)
    # Those that do not count have no influence on it.
    names = (*problem.image_names[:7], "other.jpg")
    fewer = gps_priors(problem, positions(problem, goal, names=names))
    assert fewer.origin == LocalFrame.about(given.geodetic[:7])
    assert [prior.image for prior in fewer.priors] == list(range(1, 8))
    assert any("1 image of the model without" in note for note in fewer.notes)
    assert any("1 position of images that are not in the model" in note for note in fewer.notes)


def test_images_by_the_last_part_of_their_names():
    problem, goal = problem_and_goal()
    folders = problem.replace(image_names=[f"left/{name}" for name in problem.image_names])
    assert len(gps_priors(folders, positions(problem, goal)).priors) == 8


def test_places_count_what_is_used_by_role():
    def point(name, role, up):
        one = (0.3, -0.4, up)
        return ControlPointError(name, role, 3, one, one, (0.1, 0.1, 0.1), 0.5, (), False)

    roles = ("control", "check", "control", "unused", "control", "check", "unused")
    points = tuple(point(f"t{k}", role, 0.1 * k) for k, role in enumerate(roles))
    images = tuple(
        ImageError(f"{k}.jpg", (k, 0.0, 0.0), used, sigmas)
        for k, (used, sigmas) in enumerate(((True, 2.9), (True, 3.1), (False, 9.0), (True, 4.0)))
    )
    here = Similarity(2.0, np.eye(3), np.zeros(3))
    place = Georeference(None, None, here, images, (), control_points=points)
    facts = dict(place.displays[0].facts)
    assert facts["positions"].startswith("3 of 4 images")
    assert facts["control points"] == "3 of 7 used, 2 check points"
    assert [one.name for one in place.suspects] == ["3.jpg", "1.jpg"]
    for kind, up in (("control", (0, 0.2, 0.4)), ("check", (0.1, 0.5))):
        assert place.rms_of(kind) == pytest.approx((0.3, 0.4, np.sqrt(np.mean(np.square(up)))))
    assert place.rms_of("gps")[0] == pytest.approx(np.sqrt((0 + 1 + 9) / 3))
    assert place.rms == place.rms_of("control")


def test_what_became_of_them():
    problem, goal = problem_and_goal(noise=0.1)
    wrong = goal.projection_centers.copy()
    wrong[3] += [3.5, 0, 0]
    wrong[5] += [0, 5.0, 0]
    given = positions(problem, goal, geodetic=FRAME.to_geodetic(wrong))
    settings = {"gps_sigma": 1.0, "prior_loss": "tukey", "origin": FRAME}
    known = gps_priors(problem, given, **settings)
    result = bundle.solve(problem, priors=known.priors)
    place = known.georeference(result)
    assert [image.name for image in place.suspects] == ["image5.jpg", "image3.jpg"]
    assert [image.sigmas for image in place.suspects] == pytest.approx([5, 3.5], abs=0.1)
    assert place.suspects[1].residual[0] == pytest.approx(-3.5, abs=0.1)
    expected = np.sqrt(np.mean([np.square(image.residual) for image in place.images], axis=0))
    np.testing.assert_allclose(place.rms, expected)
    assert "image5.jpg" in repr(place)
    assert "image4.jpg" not in repr(place)
    content = json.loads(json.dumps(place.asdict()))
    assert content["origin"] == FRAME.asdict()
    assert content["pipeline"] == FRAME.pipeline
    np.testing.assert_array_equal(content["similarity"]["rotation"], result.similarity.rotation)
    unmoved = bundle.solve(goal, priors=known.priors, align=False)
    with pytest.raises(InputError, match="a solve that aligned"):
        known.georeference(unmoved)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"gps_sigma": 0}, "gps_sigma:"),
        ({"gps_sigma": (1, 2, 3)}, "gps_sigma:"),
        ({"antenna": [0, 0]}, "antenna: expected 3 numbers"),
        ({"prior_loss": "no"}, "prior_loss: expected one of"),
        ({"prior_loss_scale": -1}, "prior_loss_scale: expected more than 0"),
        ({"gps": None}, "gps: expected"),
        ({"gps": 5}, "gps: expected"),
        ({"gps": "exif"}, "images: expected the folder"),
    ],
)
def test_wrong_arguments_are_named(settings, words):
    problem, goal = problem_and_goal()
    arguments = {"gps": positions(problem, goal), **settings}
    with pytest.raises(InputError, match=words):
        gps_priors(problem, arguments.pop("gps"), **arguments)


def test_a_flight_in_utm_is_the_same_flight(tmp_path):
    """Coordinates of a map give the local frame that longitude and latitude do."""
    import pyproj

    problem, goal = problem_and_goal()
    geodetic = FRAME.to_geodetic(goal.projection_centers)
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32615", always_xy=True)
    rows = []
    for name, (latitude, longitude, height) in zip(problem.image_names, geodetic, strict=True):
        x, y = to_utm.transform(longitude, latitude)
        rows.append(f"{name} {x:.6f} {y:.6f} {height:.6f}")
    path = tmp_path / "geo.txt"
    path.write_text("\n".join(["WGS84 UTM 15N", *rows]))
    known = gps_priors(problem, read_geo_file(path), origin=FRAME)
    found = np.array([prior.position for prior in known.priors])
    np.testing.assert_allclose(found, goal.projection_centers, atol=1e-5)
    # As they stand, the map's coordinates would be off: turned and shrunk.
    flat = np.array([row.split()[1:3] for row in rows], dtype=float)
    plane = found[:, :2] - found[0, :2]
    assert np.abs(flat - flat[0] - plane).max() > 0.1


def test_a_local_frame(tmp_path):
    problem, goal = problem_and_goal()
    centers = goal.projection_centers - goal.projection_centers[2]
    path = tmp_path / "geo.txt"
    rows = (f"{n} {x:.9f} {y:.9f} {z:.9f}" for n, (x, y, z) in
            zip(problem.image_names, centers, strict=True))  # fmt: skip
    path.write_text("\n".join(["local", *rows]) + "\n")
    found = read_geo_file(path)
    assert found.reference_system is None and found.notes == ()
    assert "Cartesian" in str(found)
    known = gps_priors(problem, path, gps_sigma=0.01)
    assert known.origin is None and len(known.priors) == problem.num_images  # 0 0 counts
    result = bundle.solve(problem, priors=known.priors, num_threads=1)
    place = known.georeference(result)
    np.testing.assert_allclose(result.problem.projection_centers, centers, atol=0.05)
    record = place.asdict()
    assert (record["reference_system"], record["origin"], record["pipeline"]) == (None,) * 3
    assert max(place.rms) < 0.05 and "Cartesian" in str(known)
    aligned = bundle.align(problem, gps=path, gps_sigma=0.01)
    assert aligned.origin is None and aligned.reference_system is None
    np.testing.assert_allclose(aligned.problem.projection_centers, centers, atol=0.05)


def test_control_points_share_the_local_frame(tmp_path):
    made = block(num_targets=4, seed=5)
    names = made.problem.image_names
    gps = tmp_path / "geo.txt"
    rows = (f"{n} {x:.9f} {y:.9f} {z:.9f}" for n, (x, y, z) in
            zip(names, made.cameras, strict=True))  # fmt: skip
    gps.write_text("\n".join(["LOCAL", *rows]) + "\n")
    lines = [
        f"{x:.9f} {y:.9f} {z:.9f} {mark.x:.9f} {mark.y:.9f} {mark.image} {gcp.name}"
        for gcp in made.gcps
        for x, y, z in [gcp.position]
        for mark in gcp.measurements
    ]
    gcps = tmp_path / "gcp_list.txt"
    gcps.write_text("\n".join(["LOCAL", *lines]) + "\n")
    known = bundle.georeference.gcp_priors(made.problem, gcps, gps=gps, gps_sigma=0.01)
    assert known.origin is None and known.reference_system is None
    result = bundle.solve(made.problem, priors=known.priors, num_threads=1)
    np.testing.assert_allclose(result.problem.projection_centers, made.cameras, atol=1e-3)
    gcps.write_text("\n".join(["EPSG:4326", *lines]) + "\n")
    with pytest.raises(InputError, match="same Cartesian frame"):
        bundle.georeference.gcp_priors(made.problem, gcps, gps=gps)


@pytest.mark.parametrize(("scale", "says"), [(1.0009, False), (0.9991, False), (1.04, True)])
def test_positions_that_scale_a_calibrated_rig_say_so(scale, says):
    problem = rig_problem()
    centers = scale * problem.projection_centers
    priors = tuple(
        bundle.PositionPrior(int(one), place, 1e-4)
        for one, place in zip(problem.image_ids, centers, strict=True)
    )
    result = bundle.solve(problem, priors=priors, num_threads=1, max_num_iterations=0)
    notes = rig_notes(result)
    assert bool(notes) == says
    longest = np.linalg.norm(problem.sensor_from_rig[:, 4:], axis=1).max()
    if says:
        assert f"{1.04 * longest:.4g} m" in notes[0] and f"{longest:.4g} in the input" in notes[0]
        assert result.similarity.scale == pytest.approx(1.04, rel=1e-4)
