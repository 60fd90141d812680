"""bundle.bundle_adjustment against pycolmap's own, over the space of its options."""

import numpy as np
import pycolmap
import pycolmap.pyceres
import pytest
from pycolmap import BundleAdjustmentGauge as Gauge
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.pycolmap import adjustment_objects
from bundle.solving.colmap_adjustment import adjusted_part
from tests.scenes import make_problem
from tests.solving.colmap_adjustment.option_space import CHANGES, EARLY, images_alone, request, rigs

MODELS = {"alone": images_alone, "rigs": rigs}
DETERMINED = {  # changes with which constant variables determine a part of the world
    *("refine_points3D=False", "constant points", "sensors", "refine_sensor_from_rig=False"),
    *("without 1 images", "without 3 images", "without 5 images", "frames 2", "frames 3"),
}
FATAL = {"constant points", "min_track_length=4", "min_track_length=6", "min_track_length=9"}
"""pycolmap aborts the process for a constant point that takes no part."""


@pytest.fixture(autouse=True)
def _no_log():
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 3
    yield
    pycolmap.logging.minloglevel = level


def values(reconstruction):
    """Return every number of a reconstruction that an adjustment can change."""
    rigs = sorted(reconstruction.rigs.items())
    sensors = [
        rig.sensor_from_rig(s).matrix()
        for _, rig in rigs
        for s in sorted(rig.non_ref_sensors, key=lambda s: s.id)
    ]
    return {
        "points": np.array([p.xyz for _, p in sorted(reconstruction.points3D.items())]),
        "frames": np.array(
            [
                f.rig_from_world.matrix()
                for _, f in sorted(reconstruction.frames.items())
                if f.has_pose()
            ]
        ),
        "cameras": np.array([c.params for _, c in sorted(reconstruction.cameras.items())]),
        "sensors": np.array(sensors),
    }


def adjusted(kind, names, seed, gauge=None):
    """Return reconstruction and summary of pycolmap's own adjustment."""
    reconstruction = MODELS[kind](seed)
    options, config = request(reconstruction, names, seed)
    if gauge is not None:
        config.fix_gauge(gauge)
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
    return reconstruction, adjuster.solve()


def check(kind, names, seed=0):
    """Compare cost, parameters and summary with pycolmap's."""
    mine = MODELS[kind](seed)
    start = values(mine)
    options, config = request(mine, names, seed)
    summary = bundle.bundle_adjustment(mine, options, config)
    theirs, expected = adjusted(kind, names, seed)
    assert type(summary) is type(expected)
    if not hasattr(expected, "ceres_summary"):
        assert all((start[name] == value).all() for name, value in values(mine).items())
        return
    ours, its = summary.ceres_summary, expected.ceres_summary
    assert ours.initial_cost == pytest.approx(its.initial_cost, rel=1e-12)
    for count in ("parameter_blocks", "parameters", "residual_blocks", "residuals"):
        assert getattr(ours, f"num_{count}") == getattr(its, f"num_{count}"), count
    assert summary.is_solution_usable()
    assert summary.termination_type == expected.termination_type
    cost = pytest.approx(its.final_cost, rel=1e-6 if EARLY & set(names) else 1e-10)
    if config.fixed_gauge == Gauge.THREE_POINTS and ours.final_cost != cost:
        check_three_points(kind, names, seed, start, mine, ours.final_cost)
        return
    is_determined = config.fixed_gauge == Gauge.TWO_CAMS_FROM_WORLD and DETERMINED & set(names)
    if is_determined and ours.final_cost != cost:  # pycolmap fixes more than is free
        _, free = adjusted(kind, names, seed, Gauge.UNSPECIFIED)
        rel = 1e-3 if EARLY & set(names) else 1e-9
        assert ours.final_cost < its.final_cost
        assert ours.final_cost == pytest.approx(free.ceres_summary.final_cost, rel=rel)
        return
    assert ours.final_cost == cost
    assert ours.num_residuals_reduced == summary.num_residuals == expected.num_residuals
    assert ours.num_effective_parameters_reduced == its.num_effective_parameters_reduced
    precision = 1e-4 if EARLY & set(names) else 1e-5
    for name, value in values(mine).items():
        scale = 1 + np.abs(value)
        difference = np.abs(value - values(theirs)[name]) / scale
        assert difference.max(initial=0) < precision, name


def check_three_points(kind, names, seed, start, mine, cost):
    """Expect pycolmap's cost for the three points that did not move; with rigs, none is fixed."""
    still = (values(mine)["points"] == start["points"]).all(axis=1)
    ids = np.array(sorted(mine.points3D))[still]
    reconstruction = MODELS[kind](seed)
    options, config = request(reconstruction, names, seed)
    lengths = [reconstruction.point3D(i).track.length() for i in ids]
    ids = ids[np.array(lengths, int) >= options.min_track_length]
    for point_id in ids:
        if config.has_variable_point(point_id):
            config.remove_variable_point(point_id)
        config.add_constant_point(point_id)
    config.fix_gauge(Gauge.UNSPECIFIED)
    expected = pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    assert len(ids) >= 3 or kind == "rigs" or "refine_rig_from_world=False" in names
    rel = 1e-3 if EARLY & set(names) else 1e-9
    assert cost <= expected.ceres_summary.final_cost * (1 + rel)
    if len(ids) in (0, 3):
        assert cost == pytest.approx(expected.ceres_summary.final_cost, rel=rel)


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("name", CHANGES)
def test_each_option_alone(kind, name):
    check(kind, (name,))


@pytest.mark.parametrize("seed", range(60))
def test_combinations_of_options(seed):
    rng = np.random.default_rng([seed, 5])
    names = rng.choice(list(CHANGES), rng.integers(2, 6), replace=False).tolist()
    if "constant points" in names:
        names = [name for name in names if name == "constant points" or name not in FATAL]
    check(list(MODELS)[seed % 2], tuple(names), seed)


def test_without_config_as_pycolmap_bundle_adjustment():
    mine, theirs = images_alone(), images_alone()
    for reconstruction in (mine, theirs):  # an observation of a point behind its camera
        point = reconstruction.point3D(5)
        pose = reconstruction.image(1).cam_from_world()
        point.xyz = pose.inverse() * np.array([0.1, 0.1, -0.1])
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    pycolmap.bundle_adjustment(theirs, options)
    summary = bundle.bundle_adjustment(mine, options)
    assert isinstance(summary, pycolmap.CeresBundleAdjustmentSummary)
    assert mine.compute_num_observations() == theirs.compute_num_observations()
    assert mine.compute_num_observations() < images_alone().compute_num_observations()
    for reconstruction in (mine, theirs):
        reconstruction.delete_point3D(5)  # far away, and hardly determined
    for name, value in values(mine).items():
        assert value == pytest.approx(values(theirs)[name], rel=1e-3, abs=1e-3)
    errors = [point.error for _, point in sorted(mine.points3D.items())]
    assert errors == pytest.approx([p.error for _, p in sorted(theirs.points3D.items())], rel=1e-2)


REFUSED = {
    "options.ceres.solver_options.use_nonmonotonic_steps": True,
    "options.ceres.solver_options.jacobi_scaling": False,
    "options.ceres.solver_options.use_inner_iterations": True,
    "options.ceres.solver_options.min_lm_diagonal": 1e-3,
    "options.ceres.solver_options.max_lm_diagonal": 1e3,
    "options.ceres.solver_options.min_relative_decrease": 0.1,
    "options.ceres.solver_options.max_trust_region_radius": 1e5,
    "options.ceres.solver_options.min_trust_region_radius": 1e-3,
    "options.ceres.solver_options.max_num_consecutive_invalid_steps": 3,
    "options.ceres.solver_options.check_gradients": True,
    "options.ceres.solver_options.minimizer_type": pycolmap.pyceres.MinimizerType.LINE_SEARCH,
    "options.backend": pycolmap.BundleAdjustmentBackend.CASPAR,
    "options.ceres.loss_function_scale": 0.0,
    "options.ceres.solver_options.function_tolerance": -1.0,
    "options.min_track_length": -1,
}


@pytest.mark.parametrize("place", REFUSED)
def test_what_bundle_cannot_honour_is_refused_by_name(place):
    reconstruction = images_alone()
    before = values(reconstruction)
    options, config = request(reconstruction, ["HUBER 0.5"])
    owner = options
    for name in place.split(".")[1:-1]:
        owner = getattr(owner, name)
    setattr(owner, place.rpartition(".")[2], REFUSED[place])
    with pytest.raises(bundle.InputError, match=place.replace(".", r"\.")):
        bundle.bundle_adjustment(reconstruction, options, config)
    assert all((before[name] == value).all() for name, value in values(reconstruction).items())


def test_accuracy_of_iterative_solvers_is_refused_only_if_one_is_requested():
    reconstruction = images_alone()
    options, config = request(reconstruction, ())
    options.ceres.solver_options.eta = 0.5
    bundle.bundle_adjustment(images_alone(), options, config)
    options.ceres.auto_select_solver_type = False
    solver_type = pycolmap.pyceres.LinearSolverType.ITERATIVE_SCHUR
    options.ceres.solver_options.linear_solver_type = solver_type
    with pytest.raises(bundle.InputError, match=r"solver_options\.eta"):
        bundle.bundle_adjustment(reconstruction, options, config)
    options.ceres.solver_options.eta = 0.1
    summary = bundle.bundle_adjustment(reconstruction, options, config)
    assert summary.ceres_summary.linear_solver_type_used == solver_type


@pytest.mark.parametrize("kind", MODELS)
def test_a_solve_at_the_minimum_rejects_no_steps_for_rounding(kind):
    reconstruction = MODELS[kind](0)
    options, config = request(reconstruction, (), 0)
    options.ceres.solver_options.gradient_tolerance = 1e-30  # out of reach
    for _ in range(2):
        summary = bundle.bundle_adjustment(reconstruction, options, config).ceres_summary
        assert summary.termination_type == pycolmap.pyceres.TerminationType.CONVERGENCE
        assert summary.num_unsuccessful_steps == 0
    assert summary.num_successful_steps <= 3


def test_ids_that_do_not_exist_and_wrong_types_are_named():
    reconstruction = images_alone()
    options, config = request(reconstruction, ())
    config.add_image(99)
    with pytest.raises(bundle.InputError, match=r"config\.images.*99"):
        bundle.bundle_adjustment(reconstruction, options, config)
    config.remove_image(99)
    config.add_variable_point(4711)
    with pytest.raises(bundle.InputError, match=r"config\.variable_points.*4711"):
        bundle.bundle_adjustment(reconstruction, options, config)
    for wrong in (
        {"reconstruction": 3},
        {"reconstruction": reconstruction, "options": {}},
        {"reconstruction": reconstruction, "config": options},
    ):
        with pytest.raises(bundle.InputError, match="expected"):
            bundle.bundle_adjustment(**wrong)


def local_config(reconstruction, num_points=3):
    """Three images, and points that other images see, too."""
    config = pycolmap.BundleAdjustmentConfig()
    images = sorted(reconstruction.reg_image_ids())[:3]
    for image_id in images:
        config.add_image(image_id)
    wide = []
    for point_id, point in sorted(reconstruction.points3D.items()):
        seen_by = {element.image_id for element in point.track.elements}
        wide += [point_id] if seen_by & set(images) and seen_by - set(images) else []
    for point_id in wide[:num_points]:
        config.add_variable_point(point_id)
    return config, wide


def wrong_keypoint(reconstruction, point_id, inside):
    """Let a keypoint of a track refer to another point; inside or outside of the first images."""
    images = sorted(reconstruction.reg_image_ids())[:3]
    track = reconstruction.point3D(point_id).track.elements
    element = next(e for e in track if (e.image_id in images) == inside)
    other = next(key for key in sorted(reconstruction.points3D) if key > point_id)
    reconstruction.image(element.image_id).points2D[element.point2D_idx].point3D_id = other
    return element.image_id, element.point2D_idx


def test_a_local_adjustment_reads_only_what_its_images_and_points_need():
    reconstruction, broken = rigs(0), rigs(0)
    config, wide = local_config(reconstruction)
    wrong_keypoint(broken, wide[5], inside=False)
    for model in (reconstruction, broken):
        bundle.bundle_adjustment(model, None, config)
    for name, value in values(reconstruction).items():
        assert (values(broken)[name] == value).all(), name
    with pytest.raises(bundle.InputError, match=f"point {wide[5]}: expected one track element"):
        bundle.bundle_adjustment(broken)


def test_tracks_that_do_not_match_the_keypoints_read_are_named():
    def refused(model, match):
        before = values(model)
        with pytest.raises(bundle.InputError, match=match):
            bundle.bundle_adjustment(model, None, config)
        assert all((before[name] == value).all() for name, value in values(model).items())

    config, wide = local_config(rigs(0))
    model = rigs(0)
    image_id, index = wrong_keypoint(model, wide[0], inside=False)
    where = f"found keypoint {index} of image {image_id}"
    refused(model, f"point {wide[0]}: expected keypoints that refer to it in its track, {where}")

    model = rigs(0)
    wrong_keypoint(model, wide[1], inside=True)
    refused(model, f"point {wide[1]}: expected one track element for each keypoint")

    model = rigs(0)
    first = model.point3D(wide[0]).track.elements[0]
    element = first.image_id, first.point2D_idx  # `first` refers to memory that add_element frees
    for _ in range(2):
        model.point3D(wide[0]).track.add_element(*element)
    refused(model, f"point {wide[0]}: expected one track element")

    model = rigs(0)
    track = model.point3D(wide[0]).track
    places = [(element.image_id, element.point2D_idx) for element in track.elements]
    outside = [place for place in places if place[0] not in config.images]
    assert len(outside) > 1
    track.add_element(*outside[0])
    refused(model, f"point {wide[0]}: expected one track element")

    model = rigs(0)
    last = sorted(model.reg_image_ids())[-1]
    beyond = model.image(last).num_points2D()
    model.point3D(wide[0]).track.add_element(last, beyond)  # no such keypoint
    refused(model, f"point {wide[0]}: expected keypoints .* keypoint {beyond} of image {last}")

    model = rigs(0)
    model.deregister_frame(model.image(last).frame_id)
    model.point3D(wide[0]).track.add_element(last, 0)
    refused(model, f"point {wide[0]}: expected keypoints .* image {last}")

    model = rigs(0)
    model.point3D(wide[0]).track.add_element(4711, 0)  # no such image
    refused(model, f"point {wide[0]}: expected keypoints .* image 4711")

    model = rigs(0)
    image = model.image(min(config.images))
    index = image.get_observation_point2D_idxs()[0]
    image.points2D[index].point3D_id = 10**9
    where = f"image {image.image_id}, keypoint {index}"
    refused(model, f"{where}: expected a point of the reconstruction, found point {10**9}")


def test_a_point_with_more_keypoints_than_its_track_has_elements_is_named():
    model = rigs(0)
    images = sorted(model.reg_image_ids())
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in images[:-1]:
        config.add_image(image_id)
    tracks = {key: point.track.elements for key, point in sorted(model.points3D.items())}
    inside = [key for key, track in tracks.items() if images[-1] not in {e.image_id for e in track}]
    image = model.image(images[0])
    index = next(k for k, p in enumerate(image.points2D) if p.point3D_id != inside[0])
    image.points2D[index].point3D_id = inside[0]
    count = len(tracks[inside[0]])
    with pytest.raises(bundle.InputError, match=f"point {inside[0]}: .* found {count} elements"):
        bundle.bundle_adjustment(model, None, config)


def test_exchanged_keypoints_are_named_if_the_whole_model_is_adjusted():
    model = rigs(0)
    first, second = sorted(model.points3D)[:2]
    places = [model.point3D(key).track.elements[0] for key in (first, second)]
    for place, key in zip(places, (second, first), strict=True):
        model.image(place.image_id).points2D[place.point2D_idx].point3D_id = key
    with pytest.raises(bundle.InputError, match=f"point {first}: expected keypoints that refer"):
        bundle.bundle_adjustment(model)


def read(reconstruction, config, min_track_length=0):
    content = adjustment_objects.config_of(reconstruction, config)
    return content, adjustment_objects.adjusted_fields(reconstruction, content, min_track_length)


def test_observations_of_a_part_ascend_whichever_images_the_configuration_names():
    reconstruction = rigs(0)
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in sorted(reconstruction.reg_image_ids())[-3:]:
        config.add_image(image_id)
    for point_id in sorted(reconstruction.points3D):
        config.add_variable_point(point_id)
    fields = read(reconstruction, config)[1].fields
    assert len(fields["image_ids"]) > 3
    expected = [
        (key, image_id, *image.points2D[index].xy)
        for key in sorted(reconstruction.points3D)
        for image_id, index in sorted(
            (one.image_id, one.point2D_idx) for one in reconstruction.point3D(key).track.elements
        )
        for image in [reconstruction.image(image_id)]
    ]
    columns = (
        fields["point_ids"][fields["observation_point"]],
        fields["image_ids"][fields["observation_image"]],
        *fields["observation_xy"].T,
    )
    assert list(zip(*(column.tolist() for column in columns), strict=True)) == expected


def test_images_whose_points_are_all_left_out_take_no_part():
    reconstruction = images_alone(0)
    config = pycolmap.BundleAdjustmentConfig()
    images = sorted(reconstruction.reg_image_ids())
    for image_id in images:
        config.add_image(image_id)
    seen = [p.point3D_id for p in reconstruction.image(images[0]).get_observation_points2D()]
    for point_id in seen:
        track = reconstruction.point3D(point_id).track.elements
        for image_id, index in [(e.image_id, e.point2D_idx) for e in track][2:]:
            reconstruction.delete_observation(image_id, index)
    assert images[0] not in read(reconstruction, config, min_track_length=3)[1].fields["image_ids"]


@pytest.mark.parametrize(("more", "threads"), [(0, 2), (1, 1)])
def test_few_residuals_are_solved_by_one_thread(more, threads):
    reconstruction = rigs(0)
    config, part = read(reconstruction, None)
    options = pycolmap.BundleAdjustmentOptions()
    options.ceres.solver_options.num_threads = 2
    count = 2 * len(part.fields["observation_image"])
    options.ceres.min_num_residuals_for_cpu_multi_threading = count + more
    made = adjusted_part(part, adjustment_objects.options_of(options), config)
    assert made.options.num_threads == threads


def test_a_point_that_is_deleted_during_the_solve_is_named():
    reconstruction = rigs(0)
    config, wide = local_config(reconstruction)
    before = values(reconstruction)

    def delete(_):
        if reconstruction.exists_point3D(wide[2]):
            reconstruction.delete_point3D(wide[2])

    with pytest.raises(bundle.InputError, match=f"point {wide[2]} was deleted"):
        bundle.bundle_adjustment(reconstruction, None, config, progress=delete)
    after = values(reconstruction)
    for name in ("frames", "cameras", "sensors"):
        assert (after[name] == before[name]).all(), name
    assert len(after["points"]) == len(before["points"]) - 1


def test_points_that_change_places_during_the_solve_get_their_own_values():
    """Points are found again by their ids: memory of one may belong to another by then."""
    mine, expected = rigs(0), rigs(0)
    config, wide = local_config(mine)
    bundle.bundle_adjustment(expected, None, config)
    moved = {}

    def exchange(_):
        if moved:
            return
        for key in wide[:4]:
            track = mine.point3D(key).track.elements
            places = [(element.image_id, element.point2D_idx) for element in track]
            moved[key] = mine.point3D(key).xyz.copy(), places
        for key in moved:
            mine.delete_point3D(key)
        for key, (xyz, places) in moved.items():  # into the memory of the last first
            point = pycolmap.Point3D(xyz=xyz)
            for place in places:
                point.track.add_element(*place)
            mine.add_point3D_with_id(key, point)

    bundle.bundle_adjustment(mine, None, config, progress=exchange)
    assert len(moved) == 4
    assert (values(mine)["points"] == values(expected)["points"]).all()


def test_an_empty_configuration_does_nothing():
    summary = bundle.bundle_adjustment(images_alone(), config=pycolmap.BundleAdjustmentConfig())
    assert type(summary) is pycolmap.BundleAdjustmentSummary
    assert summary.num_residuals == 0


def test_a_cancelled_token_and_a_time_limit_stop_the_solve():
    types = pycolmap.BundleAdjustmentTerminationType
    options, config = request(images_alone(), ())
    token = pycolmap.CancellationToken()
    seen = []

    def cancel(iteration):
        seen.append(iteration["iteration"])
        if len(seen) == 2:
            token.cancel()

    summary = bundle.bundle_adjustment(
        images_alone(), options, config, cancellation_token=token, progress=cancel
    )
    assert summary.termination_type == types.USER_SUCCESS
    assert len(seen) == 2
    assert summary.ceres_summary.final_cost < summary.ceres_summary.initial_cost
    options.ceres.solver_options.max_solver_time_in_seconds = 0.0
    summary = bundle.bundle_adjustment(images_alone(), options, config)
    assert summary.termination_type == types.NO_CONVERGENCE
    assert "time" in summary.ceres_summary.message


def test_the_summary_is_printed_unless_print_summary_is_false(capsys):
    options, config = request(images_alone(), ())
    bundle.bundle_adjustment(images_alone(), options, config)
    assert capsys.readouterr() == ("", "")
    options.print_summary = True
    bundle.bundle_adjustment(images_alone(), options, config)
    out, err = capsys.readouterr()
    assert out == ""
    assert "Termination: CONVERGENCE" in err


@pytest.mark.parametrize("name", ["maupertuis", "crane_mast", "batmo_rigs"])
def test_real_models(bundle_data, name):
    mine, theirs = (pycolmap.Reconstruction(bundle_data / "colmap" / name) for _ in range(2))
    options, config = request(mine, ())
    summary = bundle.bundle_adjustment(mine, options, config)
    expected = pycolmap.create_default_bundle_adjuster(options, config, theirs).solve()
    cost = expected.ceres_summary.final_cost
    assert summary.ceres_summary.final_cost == pytest.approx(cost, rel=1e-9)
    assert mine.num_points3D() == theirs.num_points3D()
    colours = [p.color.tolist() for _, p in sorted(mine.points3D.items())]
    assert colours == [p.color.tolist() for _, p in sorted(theirs.points3D.items())]


@pytest.mark.parametrize("part", [False, True])
def test_images_all_around_with_cameras_of_their_own(part):
    """The scale is pycolmap's, and a camera of neighbours only is constant."""
    scene = bundle.synthesize(
        scene="orbit", num_images=8, num_points=80, seed=4, cameras="individual"
    )
    mine, theirs = scene.problem.to_pycolmap(), scene.problem.to_pycolmap()
    options, config = request(mine, ["HUBER 2.0"])
    if part:
        config.fix_gauge(Gauge.UNSPECIFIED)
        for image_id in sorted(config.images)[3:]:
            config.remove_image(image_id)
        for point_id in sorted(mine.points3D):
            config.add_variable_point(point_id)
    start = values(mine)
    bundle.bundle_adjustment(mine, options, config)
    pycolmap.create_default_bundle_adjuster(options, config, theirs).solve()
    for name, value in values(mine).items():
        assert value == pytest.approx(values(theirs)[name], rel=1e-4, abs=1e-5), name
    still = (values(mine)["cameras"] == start["cameras"]).all(axis=1)
    assert still.tolist() == [False] * 3 + [True] * 5 if part else not still.any()


def test_the_scale_is_kept_by_the_coordinate_that_pycolmap_keeps():
    """The second image is rolled by 90 degrees: its largest coordinate is not that of the first."""
    problem = make_problem(num_images=6, num_points=60, seed=2)
    roll = np.array([[0.0, -1.0], [1.0, 0.0]])
    poses, xy = problem.cam_from_world.copy(), problem.observation_xy.copy()
    turned = Rotation.from_euler("z", 90, degrees=True) * Rotation.from_quat(poses[1, :4])
    poses[1, :4] = turned.as_quat()
    poses[1, 4:6] = roll @ poses[1, 4:6]
    seen = problem.observation_image == 1
    centre = problem.camera_params[1, 1:3]
    xy[seen] = (xy[seen] - centre) @ roll.T + centre
    problem = problem.replace(cam_from_world=poses, observation_xy=xy)
    mine, theirs = problem.to_pycolmap(), problem.to_pycolmap()
    options, config = request(mine, ())
    bundle.bundle_adjustment(mine, options, config)
    pycolmap.create_default_bundle_adjuster(options, config, theirs).solve()
    for name, value in values(mine).items():
        assert value == pytest.approx(values(theirs)[name], rel=1e-5, abs=1e-6), name
