"""bundle.align: synthetic flights, real control points, and input that cannot be used."""

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, align
from bundle.georeference import survey
from bundle.georeference.control_point import Measurement
from bundle.georeference.gcp_list import read_gcp_list
from bundle.georeference.gps_positions import GpsPositions
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.similarity import Similarity, moved
from bundle.georeference.similarity_fit import Correspondences, fit_similarity
from bundle.georeference.text_lines import ImageIndex
from bundle.georeference.triangulated_targets import triangulate
from bundle.model.lenses.exact_image import pixel_rays
from bundle.model.residuals import reprojection_errors
from bundle.model.rigid_motions import quaternion_from_matrix, rotation_matrices
from tests.formulas import PARAMS as MODELS
from tests.georeference.blocks import MODEL, PARAMS, TRUTH, block
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, project

CLEAN = ("scale", "rotation", "translation")


def close(ours, theirs, tolerance):
    for name in CLEAN:
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=tolerance)


def with_gcp(gcps, name, **changes):
    return [dataclasses.replace(p, **changes) if p.name == name else p for p in gcps]


def test_a_moved_problem_projects_as_before():
    problem = make_problem(model="OPENCV", num_images=4)
    turned = moved(problem, TRUTH)
    before, after = reprojection_errors(problem)[0], reprojection_errors(turned)[0]
    np.testing.assert_allclose(after, before, rtol=1e-9)
    np.testing.assert_allclose(turned.points, TRUTH.apply(problem.points), atol=1e-12)
    np.testing.assert_allclose(
        turned.projection_centers, TRUTH.apply(problem.projection_centers), atol=1e-12
    )
    np.testing.assert_array_equal(turned.observation_xy, problem.observation_xy)


def test_a_moved_problem_with_rigs_projects_as_before():
    problem = rig_problem(num_alone=2)
    turned = moved(problem, TRUTH)
    before, after = reprojection_errors(problem)[0], reprojection_errors(turned)[0]
    np.testing.assert_allclose(after, before, rtol=1e-8, atol=1e-9)
    arms = problem.sensor_from_rig[:, 4:]
    assert np.abs(arms).max() > 0
    np.testing.assert_allclose(turned.sensor_from_rig[:, 4:], TRUTH.scale * arms, rtol=1e-12)
    np.testing.assert_allclose(
        turned.projection_centers, TRUTH.apply(problem.projection_centers), atol=1e-9
    )


def test_quaternions_are_scipys():
    quaternions = Rotation.random(20, random_state=0).as_quat()
    expected = Rotation.from_quat(quaternions).as_matrix()
    np.testing.assert_allclose(rotation_matrices(3 * quaternions), expected, atol=1e-14)
    for matrix in (*expected, np.eye(3), np.diag([1.0, -1, -1])):
        found = Rotation.from_quat(quaternion_from_matrix(matrix[None])[0]).as_matrix()
        np.testing.assert_allclose(found, matrix, atol=1e-14)


@pytest.mark.parametrize("model", sorted(MODELS))
def test_directions_of_pixels_are_found_for_every_model(model):
    params = np.asarray(MODELS[model], dtype=float)
    rng = np.random.default_rng(0)
    for direction in np.column_stack([rng.uniform(-0.3, 0.3, (5, 2)), np.ones(5)]):
        xy = project(model, params, direction[None])[0]
        (found,), (is_seen,) = pixel_rays(model, params, xy[None])
        np.testing.assert_allclose(found, direction / np.linalg.norm(direction), atol=1e-9)
        assert is_seen


def test_directions_behind_the_camera_and_pixels_without_one():
    back = np.array([0.3, -0.2, -0.9])
    params = np.array([1000.0, 500.0])
    xy = project("EQUIRECTANGULAR", params, back[None])[0]
    (found,), (is_seen,) = pixel_rays("EQUIRECTANGULAR", params, xy[None])
    np.testing.assert_allclose(found, back / np.linalg.norm(back), atol=1e-9)
    assert is_seen
    # Barrel distortion of this size turns around before the pixel.
    folded = np.array([100.0, 0, 0, -0.3])
    assert not pixel_rays("SIMPLE_RADIAL", folded, np.array([[500.0, 0]]))[1].any()


def test_targets_are_triangulated_at_scipys_minimum():
    flight = block(3, pixel_noise=1.0)
    index = ImageIndex(flight.problem)
    own = [
        dataclasses.replace(
            p, measurements=[m._replace(sigma=0.5 + i) for i, m in enumerate(p.measurements)]
        )
        for p in flight.gcps
    ]
    rotations = Rotation.from_quat(flight.problem.cam_from_world[:, :4])
    for target in triangulate(flight.problem, own, index, pixel_sigma=9.0):
        sigma = np.array([m.sigma for m in target.measurements])[:, None]
        xy = np.array([(m.x, m.y) for m in target.measurements])

        def residuals(point, xy=xy, sigma=1.0):
            in_camera = rotations.apply(point) + flight.problem.cam_from_world[:, 4:]
            return ((project(MODEL, PARAMS, in_camera) - xy) / sigma).ravel()

        found = least_squares(
            residuals, target.position + 0.01, kwargs={"sigma": sigma}, xtol=1e-15, ftol=1e-15
        )
        np.testing.assert_allclose(target.position, found.x, atol=1e-7)
        np.testing.assert_allclose(target.residual.ravel(), residuals(target.position), atol=1e-9)
        np.testing.assert_allclose(
            target.covariance, np.linalg.inv(found.jac.T @ found.jac), rtol=1e-4
        )


def test_an_exact_block_returns_to_its_place():
    flight = block(6)
    aligned = align(flight.problem, gcps=flight.gcps)
    close(aligned.similarity, TRUTH, 1e-8)
    np.testing.assert_allclose(aligned.problem.projection_centers, flight.cameras, atol=1e-8)
    assert max(aligned.rms()) < 1e-8 and aligned.suspects == ()
    assert aligned.origin is None and aligned.reference_system is None
    assert all(p.pixels < 1e-6 and p.num_images == 9 for p in aligned.control_points)
    assert [p.position for p in aligned.control_points] == [p.position for p in flight.gcps]
    written = [point["position_enu"] for point in aligned.asdict()["gcps"]]
    assert written == [list(point.position) for point in flight.gcps]


def test_a_clean_block_has_no_suspect_and_a_wrong_target_is_one():
    flight = block(8, pixel_noise=0.3, survey_noise=0.02)
    assert align(flight.problem, gcps=flight.gcps).suspects == ()
    x, y, z = flight.gcps[5].position
    wrong = with_gcp(flight.gcps, "t5", position=(x + 1.0, y, z))
    aligned = align(flight.problem, gcps=wrong)
    assert aligned.suspects == ("t5",)
    assert aligned.control_points[5].leave_one_out[0] == pytest.approx(-1.0, abs=0.15)
    # A robust loss, or making it a check point, ends where the run without it does.
    without = align(flight.problem, gcps=[p for p in flight.gcps if p.name != "t5"])
    checked = align(flight.problem, gcps=wrong, check_points=["t5"])
    close(checked.similarity, without.similarity, 0.0)
    assert checked.suspects == ("t5",) and checked.rms("check")[0] == pytest.approx(1, abs=0.15)
    robust = align(flight.problem, gcps=wrong, prior_loss="cauchy")
    center = flight.problem.projection_centers
    gaps = [
        np.abs(found.similarity.apply(center) - without.similarity.apply(center)).max()
        for found in (robust, aligned)
    ]
    assert gaps[0] < 0.1 < gaps[1]


def test_check_points_never_influence():
    flight = block(8, pixel_noise=0.3, survey_noise=0.02, reference_system="EPSG:32632")
    to_utm = np.array([500000.0, 5000000.0, 100.0])
    gcps = [
        dataclasses.replace(p, position=tuple(np.array(p.position) + to_utm)) for p in flight.gcps
    ]
    one = align(flight.problem, gcps=gcps, check_points=["t1", "t6"])
    elsewhere = with_gcp(gcps, "t6", position=(500400.0, 5000300.0, 90.0))
    other = align(flight.problem, gcps=elsewhere, check_points=["t1", "t6"])
    close(one.similarity, other.similarity, 0.0)
    assert one.origin == other.origin
    np.testing.assert_array_equal(one.problem.points, other.problem.points)
    assert other.rms("check")[0] > 100 and one.rms() == other.rms()
    assert [p.role for p in one.control_points].count("check") == 2


def test_horizontal_targets_count_without_their_height():
    flight = block(8, relief=8.0)
    gcps = flight.gcps
    for name in ("t2", "t5", "t7"):
        x, y, _ = next(p for p in gcps if p.name == name).position
        gcps = with_gcp(gcps, name, position=(x, y, math.nan))
    aligned = align(flight.problem, gcps=gcps)
    close(aligned.similarity, TRUTH, 1e-7)
    up = [p.residual[2] for p in aligned.control_points]
    assert np.isnan(up).sum() == 3 and np.isnan(aligned.control_points[2].sigma[2])
    assert aligned.suspects == ()


def test_positions_count_by_their_sigmas_horizontal_and_vertical():
    problem, cameras = block(1).problem, block(1).cameras
    frame = LocalFrame(47.0, 11.0, 500.0)
    noise = np.random.default_rng(4).normal(size=(9, 3)) * [1, 1, 3]
    accuracy = np.full((9, 2), np.nan)
    accuracy[2] = 3.0, 0.05
    geodetic = frame.to_geodetic(cameras + noise)
    gps = GpsPositions(problem.image_names, geodetic, accuracy, "EPSG:4326", "test")
    aligned = align(problem, gps=gps, gps_sigma=(0.1, 10))
    target = aligned.origin.to_enu(geodetic)
    sigmas = np.tile([0.1, 0.1, 10.0], (9, 1))
    sigmas[2] = 3.0, 3.0, 0.05

    def residual(x):
        turned = Rotation.from_rotvec(x[1:4]).apply(problem.projection_centers)
        return ((np.exp(x[0]) * turned + x[4:] - target) / sigmas).ravel()

    similarity = aligned.similarity
    turn = Rotation.from_matrix(similarity.rotation).as_rotvec()
    found = np.r_[np.log(similarity.scale), turn, similarity.translation]
    best = least_squares(residual, found, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert 0.5 * np.sum(residual(found) ** 2) == pytest.approx(best.cost, rel=1e-9)


def test_measured_positions_place_a_model_with_their_lever_arm():
    flight = block(1)
    lever = np.array([0.4, -0.3, 0.2])
    turned = moved(flight.problem, TRUTH)
    rotations = Rotation.from_quat(turned.cam_from_world[:, :4])
    frame = LocalFrame(47.0, 11.0, 500.0)
    antennas = flight.cameras + rotations.inv().apply(lever)
    accuracy = np.full((9, 2), np.nan)
    accuracy[0] = 0.02
    names = (*flight.problem.image_names, "other.jpg")
    gps = GpsPositions(
        names,
        frame.to_geodetic(np.vstack([antennas, [0, 0, 0]])),
        np.vstack([accuracy, [[np.nan, np.nan]]]),
        "EPSG:4326",
        "test",
    )
    aligned = align(flight.problem, gps=gps, antenna=lever)
    assert aligned.similarity.scale == pytest.approx(TRUTH.scale, rel=1e-9)
    assert max(aligned.rms("gps")) < 1e-6 and len(aligned.positions) == 9
    assert max(align(flight.problem, gps=gps).rms("gps")) > 1e-3
    # In its own local frame the model is where the positions are.
    back = aligned.origin.to_geodetic(aligned.problem.projection_centers)
    np.testing.assert_allclose(frame.to_enu(back), flight.cameras, atol=1e-6)
    assert any("are not in the model" in note for note in aligned.notes)

    # Beside control points the weights decide: t0 with two centimetres against two metres.
    point = dataclasses.replace(
        flight.gcps[0],
        position=tuple(
            frame.to_geodetic(flight.surveyed[:1] + np.array([0.5, 0, 0]))[0][[1, 0, 2]].tolist()
        ),
        reference_system="EPSG:4326",
    )
    both = align(flight.problem, gcps=[point], gps=gps, antenna=lever)
    assert abs(both.control_points[0].residual[0]) < 0.5 < 10 * both.rms("gps")[0]


def test_another_model_decides_by_shared_names():
    flight = block(1)
    other = moved(flight.problem, TRUTH)
    keep = np.arange(9) != 4
    other = bundle.Problem(
        cam_from_world=other.cam_from_world[keep],
        image_names=[
            f"elsewhere/{n.split('/')[1]}"
            for n, k in zip(other.image_names, keep, strict=True)
            if k
        ],
        camera_models=[MODEL],
        camera_params=PARAMS[None],
        points=np.zeros((1, 3)),
        observation_image=[0],
        observation_point=[0],
        observation_xy=[[1, 2]],
    )
    aligned = align(flight.problem, to=other)
    close(aligned.similarity, TRUTH, 1e-9)
    assert len(aligned.shared_images) == 8 and max(aligned.rms("shared_images")) < 1e-9
    with pytest.raises(InputError, match="same name"):
        align(flight.problem, to=other.replace(image_names=[f"x{i}" for i in range(8)]))


def test_the_record_has_the_contracts_names_and_is_json():
    flight = block(5, pixel_noise=0.3, survey_noise=0.02)
    aligned = align(flight.problem, gcps=flight.gcps, check_points=["t3"])
    record = aligned.asdict()
    json.dumps(record, allow_nan=False, default=str)
    assert {"reference_system", "origin", "similarity", "gps", "gcps", "rms_enu"} <= set(record)
    assert set(record["similarity"]) == {"scale", "rotation", "translation"}
    gcp = record["gcps"][3]
    assert gcp["role"] == "check" and gcp["suspect"] is False
    similarity = record["similarity"]
    points = similarity["scale"] * flight.problem.points @ np.transpose(similarity["rotation"])
    np.testing.assert_allclose(points + similarity["translation"], aligned.problem.points)
    control = [g["residual_enu"] for g in record["gcps"] if g["role"] == "control"]
    np.testing.assert_allclose(record["rms_enu"], np.sqrt(np.mean(np.square(control), axis=0)))
    assert "t3" in repr(aligned) and "t3" in aligned._repr_html_()
    alone = repr(dataclasses.replace(aligned, control_points=()))
    assert alone.startswith("Alignment\n") and "t3" not in alone


def few(gcps, count):
    return [dataclasses.replace(p, measurements=p.measurements[:count]) for p in gcps]


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        (lambda _: {}, "expected control points"),
        (lambda _: {"gcps": []}, "gcps: "),
        (lambda _: {"gcps": 3}, "gcps: "),
        (lambda b: {"gcps": [b.gcps[0], b.gcps[0]]}, "t0"),
        (lambda b: {"gcps": few(b.gcps, 1)}, "2 images"),
        (lambda b: {"gcps": b.gcps[:2]}, "at least 3 control points.*found 2"),
        (lambda b: {"gcps": b.gcps, "check_points": ["t0", "t1"]}, "found 2"),
        (lambda b: {"gcps": b.gcps, "check_points": ["t9"]}, "check_points.*t9"),
        (lambda b: {"gcps": b.gcps, "check_points": "t1"}, "check_points"),
        (lambda b: {"gcps": b.gcps, "gcp_sigma": 0}, "gcp_sigma"),
        (lambda b: {"gcps": b.gcps, "gcp_pixel_sigma": -1}, "gcp_pixel_sigma"),
        (lambda b: {"gcps": b.gcps, "prior_loss": "best"}, "prior_loss"),
        (lambda b: {"gcps": b.gcps, "prior_loss_scale": 0}, "prior_loss_scale"),
        (lambda b: {"gcps": b.gcps, "antenna": [1, 2]}, "antenna"),
        (lambda b: {"gcps": b.gcps, "to": b.problem}, "to: "),
        (lambda b: {"gcps": b.gcps, "images": "x"}, "images"),
        (lambda _: {"gps": "exif"}, "images"),
        (lambda _: {"gps": 3}, "gps"),
        (lambda b: {"to": b.problem.replace(image_names=[""] * 9)}, "names"),
        (
            lambda b: {"gcps": with_gcp(b.gcps, "t0", reference_system="EPSG:4326")},
            "reference system",
        ),
        (lambda b: {"gcps": with_gcp(b.gcps, "t0", reference_system="nowhere")}, "nowhere|system"),
    ],
)
def test_what_cannot_be_aligned_is_refused_in_one_line(changed, wanted):
    flight = block(4)
    with pytest.raises(InputError, match=wanted) as caught:
        align(flight.problem, **changed(flight))
    assert "\n" not in str(caught.value)


def test_models_without_depth_and_losses_without_points():
    flight = block(5)
    turning = flight.problem.cam_from_world.copy()
    turning[:, 4:] = 0  # a panorama
    still = np.tile(turning[0], (9, 1))
    for poses in (turning, still):
        with pytest.raises(InputError, match=r"found 0 .*rays are parallel"):
            align(flight.problem.replace(cam_from_world=poses), gcps=flight.gcps)
    mixed = [
        dataclasses.replace(p, position=q.position)
        for p, q in zip(flight.gcps, flight.gcps[::-1], strict=True)
    ]
    with pytest.raises(InputError, match="loss leaves"):
        align(flight.problem, gcps=mixed, prior_loss="tukey")


@pytest.mark.parametrize("size", [1e-150, 1e-6, 1e6, 1e150])
def test_models_of_any_size_are_placed_or_refused(size):
    flight = block(5)
    scaled = moved(flight.problem, Similarity(size, np.eye(3), np.zeros(3)))
    if size < 1e-9:
        with pytest.raises(InputError):
            align(scaled, gcps=flight.gcps)
    else:
        aligned = align(scaled, gcps=flight.gcps)
        assert aligned.similarity.scale == pytest.approx(TRUTH.scale / size, rel=1e-9)


def test_targets_on_a_line_and_targets_that_cannot_be_triangulated():
    flight = block(6, relief=0.0)
    lined = []
    for row, point in enumerate(flight.gcps):
        lined.append(dataclasses.replace(point, position=(10.0 * row, 5.0 * row, 0.0)))
    with pytest.raises(InputError, match="one line"):
        align(flight.problem, gcps=lined)
    # A pixel far outside, rays that meet behind the cameras, and unknown images.
    odd = [m._replace(x=1e9) for m in flight.gcps[0].measurements]
    gcps = with_gcp(flight.gcps, "t0", measurements=odd)
    first = [m._replace(image=f"none{i}.jpg") for i, m in enumerate(flight.gcps[1].measurements)]
    gcps = with_gcp(gcps, "t1", measurements=first)
    aligned = align(flight.problem, gcps=gcps)
    assert [p.role for p in aligned.control_points] == ["unused"] * 2 + ["control"] * 4
    close(aligned.similarity, TRUTH, 1e-7)
    assert any("t0" in note for note in aligned.notes) and aligned.control_points[0].reason
    assert any("9 measurements of 54" in note for note in aligned.notes)


@pytest.fixture(scope="module")
def copr(bundle_data):
    """A kite's flight whose control points have a surveyed height of zero, all of them."""
    folder = bundle_data / "georeferenced" / "copr_gcp"
    return bundle.load(folder / "model"), read_gcp_list(folder / "gcp_list.txt")


def in_grid(points, used):
    """Coordinates of the map about their mean, taken for Cartesian ones."""
    mean = np.mean([p.position for p in points if p.name in used], axis=0)
    return [
        dataclasses.replace(p, position=tuple(p.position - mean), reference_system=None)
        for p in points
    ]


def test_reference_numbers_of_copr(copr, bundle_data):
    """Triangulated by the DLT, half a pixel aside, in grid coordinates, with equal weights."""
    _, points = copr
    model = pycolmap.Reconstruction(bundle_data / "georeferenced" / "copr_gcp" / "model")
    images = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    source, names = [], []
    for point in points:
        rows = []
        for name, x, y, _ in point.measurements:
            if name in images:
                camera = model.camera(images[name].camera_id)
                u, v = camera.cam_from_img(np.array([x, y]) - 0.5)
                matrix = images[name].cam_from_world().matrix()
                rows += [u * matrix[2] - matrix[0], v * matrix[2] - matrix[1]]
        if len(rows) >= 4:
            solution = np.linalg.svd(np.array(rows))[2][-1]
            source.append(solution[:3] / solution[3])
            names.append(point.name)
    assert len(names) == 8
    grid = {p.name: p.position for p in in_grid(points, names)}
    target = np.array([grid[name] for name in names])
    unit = np.tile(np.eye(3), (8, 1, 1))
    fit = fit_similarity(Correspondences(np.array(source), target, unit))
    residual = fit.similarity.apply(np.array(source)) - target
    assert fit.similarity.scale == pytest.approx(3.39307092, abs=1e-8)
    rms = np.sqrt(np.mean(residual**2, axis=0))
    np.testing.assert_allclose(rms, [1.406445, 0.903147, 0.048487], atol=1e-6)
    assert residual[names.index("gcp06"), 0] == pytest.approx(-3.544, abs=5e-4)


def test_least_squares_in_pixels_agree_to_a_millimetre(copr):
    problem, points = copr
    used = {"gcp02", "gcp03", "gcp04", "gcp05", "gcp06", "gcp07", "gcp08", "gcp09"}
    aligned = align(problem, gcps=in_grid(points, used), gcp_sigma=1000)
    assert {p.name for p in aligned.control_points if p.role == "control"} == used
    assert aligned.similarity.scale == pytest.approx(3.39307, abs=1e-4)
    np.testing.assert_allclose(aligned.rms(), [1.406, 0.903, 0.048], atol=1e-3)
    by_name = {p.name: p for p in aligned.control_points}
    assert by_name["gcp06"].residual[0] == pytest.approx(-3.54, abs=5e-3)


@pytest.mark.parametrize("sigma", [0.02, (1.0, 0.05), 0.5])
def test_the_suspect_is_named(copr, sigma):
    problem, points = copr
    aligned = align(problem, gcps=points, gcp_sigma=sigma)
    assert aligned.suspects == ("gcp06",)
    # East, north and up are not the grid: it is turned by 1.63 degrees and 1.00046 larger.
    assert aligned.similarity.scale * 1.000459 == pytest.approx(3.39307, rel=6e-3)
    if sigma == 0.5:
        assert aligned.similarity.scale * 1.000459 == pytest.approx(3.39307, rel=4e-5)
    without = align(problem, gcps=points, gcp_sigma=sigma, check_points=["gcp06"])
    assert without.suspects == ("gcp06",)
    assert without.rms()[0] < 0.85


def test_the_pixels_origin(copr):
    """Half a pixel, as OpenSfM has it, explains the measurements no worse than none."""
    problem, points = copr

    def rms(shift):
        targets = triangulate(
            problem,
            [
                dataclasses.replace(
                    p,
                    measurements=[m._replace(x=m.x + shift, y=m.y + shift) for m in p.measurements],
                )
                for p in points
            ],
            ImageIndex(problem),
            pixel_sigma=1.0,
        )
        return np.sqrt(np.mean(np.vstack([t.residual for t in targets if not t.reason]) ** 2))

    assert rms(0.0) < rms(-0.5) < rms(-2.0)


@pytest.mark.parametrize(("count", "more"), [(5, ""), (6, "1 more"), (7, "2 more")])
def test_five_measurements_outside_of_their_images_are_listed(count, more):
    """At the border of an image a point is inside."""
    problem = SimpleNamespace(
        camera_sizes=np.array([[0, 0], [8, 6]]), image_camera=np.array([1, 0])
    )
    border = [Measurement("a.jpg", x, y) for x, y in ((0, 0), (8, 6), (8, 0), (0, 6))]
    beyond = [(-0.1, 3), (8.1, 3), (4, -0.1), (4, 6.1), (9, 9), (-1, -1), (-1, 9)][:count]
    given = [*border, *(Measurement("a.jpg", *one) for one in beyond), Measurement("b.jpg", -9, 0)]
    target = SimpleNamespace(
        images=np.array([0] * (len(given) - 1) + [1]),
        measurements=given,
        point=SimpleNamespace(name="t"),
    )
    notes = survey._outside(problem, (target,))
    assert len(notes) == min(count, 5) + bool(more) and more in notes[-1]
    assert sum("outside of a.jpg (8 x 6 px)" in note for note in notes) == min(count, 5)
