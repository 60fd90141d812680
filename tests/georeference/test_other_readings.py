"""Coordinates that are read otherwise than they were meant, and such as only look so."""

import dataclasses
import functools
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.other_readings import check_readings, uprightness
from bundle.georeference.similarity import Similarity, moved
from bundle.georeference.similarity_fit import Correspondences
from bundle.georeference.survey_priors import gcp_priors, gps_priors
from tests.georeference.flights import flight

TARGETS = [
    [-20, -20, 0], [20, -20, 0.5], [20, 20, 0], [-20, 20, 1], [3, -8, 0.2], [-9, 4, 0.1],
    [11, -3, 0.4], [-4, 15, 0.2],
]  # fmt: skip
NEAR_EQUATOR = LocalFrame(3.7, 34.9, 200)
"""Where easting and northing of a UTM zone are alike, so that both readings are places."""
SYSTEM = "EPSG:32636"


def on_map(points, origin=NEAR_EQUATOR, swap=False, foot=1.0):
    """The control points in UTM, as a file would have them."""
    import pyproj

    to_map = pyproj.Transformer.from_crs(4326, int(SYSTEM[5:]), always_xy=True)
    places = origin.to_geodetic([point.position for point in points])
    x, y = to_map.transform(places[:, 1], places[:, 0])
    if swap:
        x, y = y, x
    return [
        dataclasses.replace(
            point, position=(x[row], y[row], places[row, 2] / foot), reference_system=SYSTEM
        )
        for row, point in enumerate(points)
    ]


def positions(problem, origin, swap=False, foot=1.0, source="geo.txt"):
    places = origin.to_geodetic(problem.projection_centers)
    if swap:
        places = places[:, [1, 0, 2]]
    places[:, 2] /= foot
    count = problem.num_images
    return GpsPositions(
        problem.image_names, places, np.full((count, 2), np.nan), "EPSG:4326", source
    )


CALLS = {
    "align": lambda p, **k: bundle.align(p, gcp_sigma=0.05, **k).notes,
    "refine": lambda p, gcps, **k: gcp_priors(p, gcps, gcp_sigma=0.05, **k).notes,
}


@pytest.mark.parametrize("call", CALLS)
def test_swapped_control_points_over_flat_ground(call):
    scene = flight(TARGETS, num_images=9)
    problem = scene.elsewhere()
    assert CALLS[call](problem, gcps=on_map(scene.gcps)) == ()
    with pytest.raises(InputError, match=r"gcps: columns 1 and 2 fit when exchanged.*upside down"):
        CALLS[call](problem, gcps=on_map(scene.gcps, swap=True))


@pytest.mark.parametrize("call", CALLS)
def test_swapped_control_points_over_hills_fit_many_times_better(call):
    hills = [[x, y, 6 * np.sin(x) + 8 * np.cos(y)] for x, y, _ in TARGETS]
    scene = flight(hills, num_images=9)
    problem = scene.elsewhere()
    assert CALLS[call](problem, gcps=on_map(scene.gcps)) == ()
    with pytest.raises(InputError, match="columns 1 and 2 fit when exchanged"):
        CALLS[call](problem, gcps=on_map(scene.gcps, swap=True))


@pytest.mark.parametrize("origin", [LocalFrame(48.1, 11.5, 500), LocalFrame(-33.9, 18.4, 30)])
def test_latitude_for_longitude(origin):
    scene = flight([])
    problem = scene.elsewhere()
    beside_gravity = functools.partial(gps_priors, fewest=2)
    for call in (gps_priors, beside_gravity, lambda p, g: bundle.align(p, gps=g)):
        assert call(problem, positions(scene.problem, origin)).notes == ()
        with pytest.raises(InputError, match="gps: columns 1 and 2 fit when exchanged"):
            call(problem, positions(scene.problem, origin, swap=True))


def test_positions_on_a_line_have_no_other_reading():
    """Beside a vertical they place a model; alone they are refused as a line."""
    problem = flight([], num_images=9).elsewhere()
    line = np.outer(np.arange(9.0), [30, 10, 0])
    places = dataclasses.replace(
        positions(problem, NEAR_EQUATOR), geodetic=NEAR_EQUATOR.to_geodetic(line)
    )
    with pytest.raises(InputError, match="on one line"):
        gps_priors(problem, places)
    assert gps_priors(problem, places, fewest=2).notes == ()


def test_positions_beside_control_points_have_columns_of_their_own():
    scene = flight(TARGETS, num_images=9)
    problem = scene.elsewhere()
    right, wrong = (positions(scene.problem, NEAR_EQUATOR, swap=swap) for swap in (False, True))
    gcps = {swap: on_map(scene.gcps, swap=swap) for swap in (False, True)}
    assert bundle.align(problem, gcps=gcps[False], gps=right).suspects == ()
    with pytest.raises(InputError, match="gps: columns"):
        bundle.align(problem, gcps=gcps[False], gps=wrong)
    with pytest.raises(InputError, match="gcps: columns"):
        bundle.align(problem, gcps=gcps[True], gps=right)


def test_heights_in_feet():
    hills = [[x, y, 6 * np.sin(x) + 8 * np.cos(y)] for x, y, _ in TARGETS]
    scene = flight(hills, num_images=9)
    problem = scene.elsewhere()
    for call in CALLS.values():
        with pytest.raises(InputError, match="gcps: heights fit as feet"):
            call(problem, gcps=on_map(scene.gcps, foot=0.3048))
    gps = positions(scene.problem, NEAR_EQUATOR, foot=0.3048)
    with pytest.raises(InputError, match="gps: heights fit as feet"):
        bundle.align(problem, gcps=on_map(scene.gcps), gps=gps, gps_sigma=0.5)


def test_a_map_in_feet_says_what_heights_are(tmp_path):
    path = tmp_path / "geo.txt"
    path.write_text("EPSG:2263\na.jpg 980000 190000 30\nb.jpg 980100 190000 31\n")
    notes = bundle.georeference.read_geo_file(path).notes
    assert any("metres" in note and "feet" in note for note in notes)


def turned(problem, degrees):
    """The problem's world turned about its eastern axis, the cameras with it."""
    rotation = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
    return moved(problem, Similarity(1.0, rotation, np.zeros(3)))


def test_uprightness():
    problem = flight([]).problem
    here = Similarity(1.0, np.eye(3), np.zeros(3))
    assert uprightness(problem, here) == pytest.approx(1, abs=0.1)  # nadir
    assert uprightness(turned(problem, 90), here) == pytest.approx(1, abs=0.2)  # of a facade
    assert uprightness(turned(problem, 180), here) == pytest.approx(-1, abs=0.1)
    assert uprightness(turned(problem, 45), here) == pytest.approx(np.sqrt(2), abs=0.2)
    half = Similarity(2.0, Rotation.from_euler("x", 180, degrees=True).as_matrix(), np.ones(3))
    assert uprightness(problem, half) == pytest.approx(-1, abs=0.1)


def test_a_ceiling_is_no_mistake():
    # Cameras that look up are told of; exchanged columns are another continent, and no reading.
    ceiling = turned(flight([]).problem, 180)
    origin = LocalFrame(46.8, -91.9, 200)
    found = bundle.align(ceiling, gps=positions(ceiling, origin), gps_sigma=0.1)
    assert any("look up" in note for note in found.notes)
    assert uprightness(found.problem, Similarity(1.0, np.eye(3), np.zeros(3))) < -0.5
    # Receivers do not exchange columns.
    exif = positions(ceiling, LocalFrame(48.1, 11.5, 500), source="EXIF tags in images")
    assert any("look up" in note for note in bundle.align(ceiling, gps=exif).notes)


def test_chance_does_not_decide_between_readings_that_both_fit():
    # Noise of a tenth of a sigma makes the mirrored reading fit a quarter better here.
    rng = np.random.default_rng(2)
    targets = np.column_stack([rng.uniform(-25, 25, (5, 2)), rng.normal(0, 0.02, 5)])
    meant = targets + 0.02 * rng.normal(size=(5, 3))
    given = meant[:, [1, 0, 2]]
    gps = positions(flight([]).problem, NEAR_EQUATOR)

    def correspondences(places):
        return Correspondences(targets, places, np.tile(0.04 * np.eye(3), (5, 1, 1)))

    survey = SimpleNamespace(
        frame=SimpleNamespace(origin=NEAR_EQUATOR),
        measured=correspondences(given),
        decisive=np.ones(5, bool),
        cameras=targets,
        points=(),
        positions=gps,
        problem=flight([]).problem,
        what="positions",
        decisive_places=lambda *_: correspondences(meant),
    )
    with pytest.raises(InputError, match=r"gps: columns 1 and 2 .*upside down"):
        check_readings(survey)


def test_noise_of_heights_is_not_feet():
    rng = np.random.default_rng(0)
    scene = flight([])
    gps = positions(scene.problem, NEAR_EQUATOR)
    gps.geodetic[:, 2] += 40 * rng.normal(size=16)
    assert gps_priors(scene.elsewhere(), gps, gps_sigma=(0.1, 5)).notes == ()


@pytest.mark.parametrize("seed", range(3))
def test_right_coordinates_are_never_another_reading(seed):
    rng = np.random.default_rng(seed)
    targets = np.column_stack([rng.uniform(-25, 25, (4 + seed, 2)), rng.normal(0, seed, 4 + seed)])
    scene = flight(targets, num_images=9, seed=seed, start_noise=0.05)
    problem = scene.elsewhere()
    gcps = on_map(scene.gcps)
    east, north, up = gcps[0].position
    gcps[0] = dataclasses.replace(gcps[0], position=(east + 8, north - 3, up))  # a gross error
    for sigma in (0.005, 2):
        assert not [n for n in bundle.align(problem, gcps=gcps, gcp_sigma=sigma).notes if "up" in n]
    origin = LocalFrame(rng.uniform(-60, 60), rng.uniform(-80, 80), 100)
    gps = positions(scene.problem, origin)
    gps.geodetic[:] += rng.normal(size=gps.geodetic.shape) * [2e-5, 2e-5, 5]
    assert gps_priors(problem, gps).notes == ()
