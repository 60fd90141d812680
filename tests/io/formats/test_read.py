"""Readers of other programs' files: reference numbers, files written by the manuals, ugly cases."""

import json

import numpy as np
import pytest
from PIL import Image

import bundle
from tests import scenes
from tests.io.formats import foreign_files as foreign
from tests.io.formats.foreign_files import small


def same(problem: bundle.Problem, truth: bundle.Problem, tolerance: float = 1e-9) -> None:
    """Poses, points, and errors of all observations agree, in the order of the truth's points."""
    order = np.argsort(truth.observation_point, kind="stable")
    other = np.argsort(problem.observation_point, kind="stable")
    for name in ("cam_from_world", "points"):
        one, two = getattr(problem, name), getattr(truth, name)
        if name == "cam_from_world":
            one = one * np.sign(one[:, 3:4] * two[:, 3:4] + 1e-300) ** [1, 1, 1, 1, 0, 0, 0]
        np.testing.assert_allclose(one, two, atol=tolerance)
    for name in ("observation_image", "observation_point", "observation_keypoint"):
        assert (getattr(problem, name)[other] == getattr(truth, name)[order]).all(), name
    errors = bundle.reprojection_errors(problem)[0][other]
    np.testing.assert_allclose(errors, bundle.reprojection_errors(truth)[0][order], atol=1e-6)
    rmse = np.sqrt(np.mean(errors**2))
    assert problem.source.source_rmse == pytest.approx(rmse, abs=1e-6)
    assert problem.source.rmse == pytest.approx(rmse, abs=1e-12)


def test_the_reference_numbers(bundle_data) -> None:
    bundler = bundle.load(bundle_data / "formats/bundler_lightbender")
    assert (bundler.num_images, bundler.num_points, bundler.num_observations) == (5, 249, 673)
    assert bundler.source.source_rmse == pytest.approx(0.6596493048421743, abs=1e-9)
    assert bundler.source.rmse == pytest.approx(0.6596493048421743, abs=1e-9)
    sfm = bundle.load(bundle_data / "formats/opensfm_berlin")
    assert (sfm.num_images, sfm.num_points, sfm.num_observations) == (3, 1430, 3082)
    assert sfm.source.rmse == pytest.approx(2.46476313951413, abs=1e-9)
    median = np.median(bundle.reprojection_errors(sfm)[0])
    assert median == pytest.approx(0.7964399410605569, abs=1e-9)


@pytest.mark.parametrize("name", ["bundler_lightbender", "opensfm_berlin"])
def test_a_refinement_ends_where_that_of_bal_ends(bundle_data, tmp_path, name) -> None:
    problem = bundle.load(bundle_data / "formats" / name)
    bundle.save(problem, tmp_path / "same.txt")
    other = bundle.load(tmp_path / "same.txt")
    if problem.num_cameras == 1:
        other = bundle.share_cameras(other)
    ends = [
        bundle.solve(p, gauge="none", cheirality="algebraic", function_tolerance=1e-12).summary
        for p in (problem, other)
    ]
    assert ends[0].final_cost == pytest.approx(ends[1].final_cost, rel=1e-8)


def test_bundler(tmp_path) -> None:
    truth = small()
    foreign.write_bundler(truth, tmp_path / "bundle.out")
    problem = bundle.load(tmp_path / "bundle.out", image_size=(800, 600))
    same(problem, truth)
    assert (problem.camera_sizes == [800, 600]).all() and not any(problem.image_names)
    np.testing.assert_allclose(problem.observation_xy.mean(), truth.observation_xy.mean())
    unknown = bundle.load(tmp_path / "bundle.out")  # no list.txt: sizes stay unknown
    assert not unknown.camera_sizes.any() and not unknown.camera_params[:, 1:3].any()
    assert "sizes are unknown" in unknown.source.notes[0]
    reconstruction = problem.to_pycolmap()
    assert tuple(reconstruction.point3D(problem.point_ids[5]).color) == (5, 35, 9)


def test_bundler_takes_names_and_sizes_from_the_list(tmp_path) -> None:
    truth = small()
    names = ["photos/a.jpg", "photos/b c.jpg", "photos/c.jpg", "photos/d.jpg", "photos/e.jpg"]
    (tmp_path / "bundle").mkdir()
    (tmp_path / "photos").mkdir()
    for name in names:
        Image.new("L", (640, 480)).save(tmp_path / name)
    path = tmp_path / "bundle" / "bundle.out"
    foreign.write_bundler(truth, path, unregistered=(1,), names=names)
    problem = bundle.load(tmp_path / "bundle")
    assert problem.image_names == ("photos/a.jpg", "photos/c.jpg", "photos/d.jpg", "photos/e.jpg")
    assert problem.image_ids.tolist() == [0, 2, 3, 4]
    assert (problem.camera_sizes == [640, 480]).all()
    assert (problem.camera_params[:, 1:3] == [320, 240]).all()
    assert "1 image of 5 is not registered" in problem.source.notes[0]
    (tmp_path / names[2]).unlink()
    with pytest.raises(bundle.InputError, match=r"list.txt: .*photos/c.jpg; give --image-size"):
        bundle.load(path)
    assert not bundle.load(path, image_size="unknown").camera_sizes.any()


@pytest.mark.parametrize("distortion", [0.0, -0.08, 0.05])
def test_nvm(tmp_path, distortion) -> None:
    truth = small("SIMPLE_PINHOLE", noise=0.0, perturbation=0.0)
    center = truth.camera_params[0, 1:3]
    if distortion:  # distorted measurements: (1 + r |m/f|^2) m = f p
        focal = truth.camera_params[truth.image_camera[truth.observation_image], 0]
        xy = truth.observation_xy.copy()
        for row in range(len(xy)):
            m = (xy[row] - center) / focal[row]
            roots = np.roots([distortion, 0, 1, -np.hypot(*m)])
            real = roots[np.isreal(roots)].real
            s = real[np.argmin(abs(real - np.hypot(*m)))]
            xy[row] = center + focal[row] * m * s / np.hypot(*m)
        distorted = truth.replace(observation_xy=xy)
    else:
        distorted = truth
    foreign.write_nvm(distorted, tmp_path / "model.nvm", distortion)
    problem = bundle.load(tmp_path / "model.nvm", image_size="800,600")
    assert problem.image_names == truth.image_names
    if not distortion:
        return same(problem, truth)
    assert set(problem.camera_models) == {"RADIAL"}
    assert problem.source.source_rmse < 1e-9  # exact measurements
    assert 0 < problem.source.rmse < 0.05
    assert "RADIAL was fitted" in problem.source.notes[0]
    return None


def test_nvm_with_matrices_and_spaces_in_names(tmp_path) -> None:
    truth = small("SIMPLE_PINHOLE")
    truth = truth.replace(image_names=tuple(f"my photo {k}.jpg" for k in range(4)))
    for r9t in (False, True):
        foreign.write_nvm(truth, tmp_path / "model.nvm", r9t=r9t)
        problem = bundle.load(tmp_path / "model.nvm", image_size="800,600")
        assert problem.image_names == truth.image_names
        same(problem, truth)
    bundle.save(truth, tmp_path / "own.nvm")
    again = bundle.load(tmp_path / "own.nvm", image_size="800,600")
    assert again.image_names == truth.image_names


def test_nvm_with_a_fixed_calibration(tmp_path) -> None:
    truth = small("SIMPLE_PINHOLE", shared=True)
    f, cx, cy = truth.camera_params[0].tolist()
    foreign.write_nvm(truth, tmp_path / "a.nvm", first=f"NVM_V3 FixedK {f} {cx} {f} {cy} 0")
    same(bundle.load(tmp_path / "a.nvm"), truth)
    foreign.write_nvm(truth, tmp_path / "a.nvm", first=f"NVM_V3 FixedK {f} {cx} {f} {cy} 0.1")
    with pytest.raises(bundle.InputError, match=r"r = 0.1 of the first line in all cameras"):
        bundle.load(tmp_path / "a.nvm")


@pytest.mark.parametrize("version", [0, 1, 2])
@pytest.mark.parametrize(
    "model", ["RADIAL", "OPENCV", "RADIAL_FISHEYE", "OPENCV_FISHEYE", "EQUIRECTANGULAR"]
)
def test_opensfm(tmp_path, model, version) -> None:
    truth = small(
        model,
        shared=True,
        **({"camera_sizes": [[2000, 1000]]} if model == "EQUIRECTANGULAR" else {}),
    )
    foreign.write_opensfm(truth, tmp_path, version)
    problem = bundle.load(tmp_path)
    assert problem.camera_models[0] == model
    same(problem, truth)
    assert problem.point_ids.tolist() == truth.point_ids.tolist()


def test_opensfm_dual_lenses_are_fitted(tmp_path) -> None:
    truth = small("RADIAL", shared=True)
    camera = foreign.sfm_camera(truth, 0) | {"projection_type": "dual", "transition": 0.7}
    foreign.write_opensfm(truth, tmp_path, cameras={"camera 0": camera})
    problem = bundle.load(tmp_path)
    assert problem.camera_models == ("RADIAL",) and "fitted" in problem.source.notes[0]
    assert abs(problem.source.rmse - problem.source.source_rmse) < 0.5


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("model", list(foreign.MVG))
def test_openmvg(tmp_path, model, nested) -> None:
    truth = small(model)
    if "OPENCV" in model:  # one focal length
        params = truth.camera_params.copy()
        params[:, 1] = params[:, 0]
        truth = truth.replace(camera_params=params)
    foreign.write_openmvg(truth, tmp_path / "sfm_data.json", nested=nested)
    problem = bundle.load(tmp_path)
    assert set(problem.camera_models) == {model}
    same(problem, truth)


def test_what_real_scenes_of_openmvg_have(tmp_path) -> None:
    truth = small("RADIAL")
    path = tmp_path / "sfm_data.json"
    foreign.write_openmvg(truth, path)
    content = json.loads(path.read_text())
    for view in content["views"]:
        view["value"]["ptr_wrapper"]["data"] |= {"local_path": "/", "use_pose_center_prior": True}
    content["views"][0]["value"]["ptr_wrapper"]["data"]["local_path"] = "day 1/"
    content["control_points"] = [content["structure"][0]]
    path.write_text(json.dumps(content))
    problem = bundle.load(path)
    same(problem, truth)
    names = list(truth.image_names)
    assert problem.image_names == (f"day 1/{names[0]}", *names[1:])
    assert "1 control point of the file are left out" in problem.source.notes[0]


def test_rigs_of_opensfm(tmp_path) -> None:
    """Two rig cameras share a lens, in three instances; one shot is alone."""
    from scipy.spatial.transform import Rotation

    truth = scenes.make_problem(num_images=7, num_points=40, model="RADIAL", shared=True, track=5)
    arm = np.array([0.02, -0.1, 0.01, 0.3, 0.01, -0.02])
    poses, instances = truth.cam_from_world.copy(), {}
    turn = Rotation.from_rotvec(arm[:3])
    for frame in range(3):
        left, right = 2 * frame, 2 * frame + 1
        r = Rotation.from_quat(poses[left, :4])
        poses[right, :4] = (turn * r).as_quat()
        poses[right, 4:] = turn.apply(poses[left, 4:]) + arm[3:]
        names = {truth.image_names[left]: "left", truth.image_names[right]: "right"}
        instances[str(frame)] = {
            "rotation": r.as_rotvec().tolist(),
            "translation": poses[left, 4:].tolist(),
            "rig_camera_ids": names,
        }
    last = Rotation.from_quat(poses[6, :4]).as_rotvec().tolist()
    instances["alone"] = {
        "rotation": last,
        "translation": poses[6, 4:].tolist(),
        "rig_camera_ids": {truth.image_names[6]: "other"},
    }
    rig_cameras = {
        "left": {"rotation": [0, 0, 0], "translation": [0, 0, 0]},
        "right": {"rotation": arm[:3].tolist(), "translation": arm[3:].tolist()},
        "other": {"rotation": [0, 0, 0], "translation": [0, 0, 0]},
    }
    truth = truth.replace(
        cam_from_world=poses, observation_keypoint=np.arange(truth.num_observations)
    )
    foreign.write_opensfm(truth, tmp_path / "p", rig_cameras=rig_cameras, rig_instances=instances)
    problem = bundle.load(tmp_path / "p")
    assert (problem.num_rigs, problem.num_frames, problem.num_sensors) == (1, 3, 1)
    assert problem.num_cameras == 3  # a lens per place on the rig, and one elsewhere
    np.testing.assert_allclose(problem.sensor_from_rig[0, 4:], arm[3:], atol=1e-12)
    same(problem, truth)
    bundle.save(problem, tmp_path / "sparse", "colmap")
    again = bundle.load(tmp_path / "sparse")
    assert (again.num_frames, again.num_sensors) == (3, 1)
    instances["1"]["translation"][0] += 0.1  # the shots are elsewhere than the rig says
    foreign.write_opensfm(truth, tmp_path / "q", rig_cameras=rig_cameras, rig_instances=instances)
    with pytest.raises(bundle.InputError, match="rig_instances: 1: expected a pose"):
        bundle.load(tmp_path / "q")


def test_a_flipped_convention_is_refused_with_both_numbers(tmp_path, monkeypatch) -> None:
    from bundle.io.formats import bundler

    foreign.write_bundler(small(), tmp_path / "bundle.out")
    monkeypatch.setattr(bundler, "FLIP", np.array([1.0, 1.0, 1.0]))
    with pytest.raises(bundle.InputError, match=r"RMSE.*found [\d.e+]+ px and [\d.e+]+ px"):
        bundle.load(tmp_path / "bundle.out")


def test_several_reconstructions_are_asked_for(tmp_path) -> None:
    truth = small(shared=True)
    foreign.write_opensfm(truth, tmp_path)
    path = tmp_path / "reconstruction.json"
    one = json.loads(path.read_text())[0]
    path.write_text(json.dumps([one, {**one, "points": {}}]))
    with pytest.raises(bundle.InputError, match=r"found 2 \(of 4, 4 images\); choose by"):
        bundle.load(tmp_path)
    assert bundle.load(tmp_path, reconstruction=0).num_points == 30
    assert bundle.load(tmp_path, reconstruction=1).num_points == 0
    with pytest.raises(bundle.InputError, match="from 0 to 1, found 5"):
        bundle.load(tmp_path, reconstruction=5)


def test_ugly_but_valid(tmp_path) -> None:
    """Points without views, unregistered views, repeated keys, one line per file, no points."""
    truth = small()
    few = scenes.with_observations(truth, truth.observation_point > 3)
    foreign.write_bundler(few, tmp_path / "a.out")
    problem = bundle.load(tmp_path / "a.out")
    assert problem.num_points == 30 and (problem.observation_point > 3).all()
    text = (tmp_path / "a.out").read_text().split("\n", 1)
    (tmp_path / "b.out").write_text(text[0] + "\n" + text[1].replace("\n", " "))
    assert (bundle.load(tmp_path / "b.out").points == problem.points).all()
    repeated = truth.replace(observation_keypoint=np.zeros(truth.num_observations, int))
    foreign.write_bundler(repeated, tmp_path / "c.out")
    problem = bundle.load(tmp_path / "c.out")
    assert (problem.observation_keypoint == -1).all() and "twice" in problem.source.notes[-1]
    seen = truth.observation_image != 2
    foreign.write_openmvg(
        scenes.with_observations(truth, seen), tmp_path / "s.json", without_pose=(2,)
    )
    assert bundle.load(tmp_path / "s.json").image_ids.tolist() == [0, 1, 3]
    (tmp_path / "empty.out").write_text("# Bundle file v0.3\n0 0\n")
    assert bundle.load(tmp_path / "empty.out").num_images == 0
