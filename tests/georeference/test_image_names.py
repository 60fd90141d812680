"""Images that a name means: images of one name, of one last part, in another case."""

import numpy as np
import pytest

import bundle
from bundle import GroundControlPoint, InputError
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.survey_priors import gcp_priors, gps_priors
from bundle.georeference.text_lines import ImageFinder, ImageIndex
from tests.georeference.flights import flight

TARGETS = [[-20, -20, 0], [20, -20, 0.5], [20, 20, 0], [-20, 20, 1]]
ORIGIN = LocalFrame(46.8, -91.9, 200)


def named(problem, changes):
    names = list(problem.image_names)
    for row, name in changes.items():
        names[row] = name
    return problem.replace(image_names=names)


def positions(problem, names=None):
    places = ORIGIN.to_geodetic(problem.projection_centers)
    names = tuple(problem.image_names if names is None else names)
    return GpsPositions(
        names, places[: len(names)], np.full((len(names), 2), np.nan), "EPSG:4326", "geo.txt"
    )


def test_two_images_of_one_name_have_no_position():
    problem = named(flight([]).problem, {4: "A.JPG", 7: "A.JPG"})
    given = positions(problem)
    only = GpsPositions(
        given.names[:5], given.geodetic[:5], given.accuracy[:5], "EPSG:4326", "geo.txt"
    )
    for call in (gps_priors, lambda p, g: bundle.align(p, gps=g)):
        with pytest.raises(InputError, match=r"geo.txt: .*'A.JPG', found 2 \(ids 5, 8\)"):
            call(problem, only)
    # Who is not named twice does not suffer.
    others = [row for row in range(problem.num_images) if row not in (4, 7)]
    rest = GpsPositions(
        tuple(given.names[row] for row in others),
        given.geodetic[others],
        given.accuracy[others],
        "EPSG:4326",
        "geo.txt",
    )
    assert len(gps_priors(problem, rest).priors) == len(others)


def test_names_without_their_extension():
    problem = named(flight([]).problem, {4: "7", 5: "a/b.v2.JPG", 6: "c.jpg", 7: "c.tif"})
    index = ImageIndex(problem)
    found = [index.find(name) for name in ("7", "b.v2", "x/b.v2", "b", "12")]
    assert found == [4, 5, 5, None, 12]
    with pytest.raises(InputError, match=r"found 2 \(c.jpg, c.tif\)"):
        index.find("c")
    numbered = named(problem, {row: f"{row + 2}.jpg" for row in range(problem.num_images)})
    assert ImageFinder(numbered).find("3") == 3  # an id, not the stem of the image with id 2
    given = positions(problem, [name.partition(".")[0] for name in problem.image_names[:4]])
    assert len(gps_priors(problem, given).priors) == 4


def test_two_images_of_one_name_have_no_control_points():
    scene = flight(TARGETS)
    seen = scene.gcps[0].measurements[0].image
    row = scene.problem.image_names.index(seen)
    problem = named(scene.problem, {(row + 1) % 16: seen})
    for call in (gcp_priors, lambda p, g: bundle.align(p, gcps=g)):
        with pytest.raises(InputError, match=f"control point t0: .*{seen}.*found 2"):
            call(problem, scene.gcps)


def test_a_last_part_that_two_images_share_is_refused_where_it_is_used():
    problem = named(flight([]).problem, {4: "left/a.jpg", 7: "right/a.jpg"})
    names = list(problem.image_names)
    assert len(gps_priors(problem, positions(problem, names)).priors) == 16
    names[4] = "a.jpg"
    with pytest.raises(InputError, match=r"found 2 \(left/a.jpg, right/a.jpg\)"):
        gps_priors(problem, positions(problem, names[:5]))


def test_two_positions_of_one_image_are_refused():
    problem = flight([]).problem
    given = positions(problem, [*problem.image_names[:15], "03.jpg"])
    for call in (gps_priors, lambda p, g: bundle.align(p, gps=g)):
        with pytest.raises(InputError, match="one position for each image"):
            call(problem, given)


def test_models_with_images_of_one_name_are_not_aligned_to_each_other():
    problem = flight([]).problem
    twice = named(problem, {4: problem.image_names[7]})
    for pair in ((problem, twice), (twice, problem)):
        with pytest.raises(InputError, match="found 2"):
            bundle.align(pair[0], to=pair[1])
    deep = named(problem, {4: "left/a.jpg", 7: "right/a.jpg"})
    flat = named(problem, {4: "a.jpg"})
    with pytest.raises(InputError, match=r"unique image names|found 2"):
        bundle.align(deep, to=flat)


def test_names_that_differ_in_case_are_hinted_at():
    problem = named(flight([]).problem, {3: "IMG_3.JPG"})
    names = list(problem.image_names)
    names[3] = "img_3.jpg"
    known = gps_priors(problem, positions(problem, names))
    assert len(known.priors) == 15
    assert any("img_3.jpg and IMG_3.JPG" in note for note in known.notes)
    aligned = bundle.align(problem, gps=positions(problem, names))
    assert any("img_3.jpg and IMG_3.JPG" in note for note in aligned.notes)
    loud = [name.upper() for name in flight([]).problem.image_names]
    problem = flight([]).problem
    for call in (gps_priors, lambda p, g: bundle.align(p, gps=g)):
        with pytest.raises(InputError, match="in upper and lower case"):
            call(problem, positions(problem, loud))
    scene = flight(TARGETS)
    shouted = [
        GroundControlPoint(
            name=p.name,
            position=p.position,
            measurements=[(m[0].upper() if row == 0 else m[0], *m[1:3]) for m in p.measurements],
        )
        for row, p in enumerate(scene.gcps)
    ]
    notes = bundle.align(scene.problem, gcps=shouted).notes
    assert any("case" in note for note in notes)


def test_only_images_by_a_name_of_two_is_refused():
    problem = named(flight([]).problem, {4: "A.JPG", 7: "A.JPG"})
    with pytest.raises(InputError, match=r"only_images: .*ids 5, 8"):
        bundle.solve_rounds(problem, only_images="A.JPG")
    assert bundle.solve_rounds(problem, only_images="A.*").summary.is_solution_usable
    with pytest.raises(InputError, match="ids 5, 8"):
        bundle.solve(problem, constraints=['image "A.JPG": position fixed'])


def test_info_names_images_of_one_name():
    problem = named(flight([]).problem, {4: "A.JPG", 7: "A.JPG", 9: "a.JPG"})
    found = [s for s in bundle.describe(problem).suspicions if s.kind == "images_of_one_name"]
    assert [(s.evidence["count"], s.evidence["ids"]) for s in found] == [(2, [5, 8])]
    assert not [
        s for s in bundle.describe(flight([]).problem).suspicions if s.kind == "images_of_one_name"
    ]
