"""Writers: round trips, COLMAP -> X -> COLMAP, losses, and readers of other packages."""

import json

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.io.formats.foreign_files import small
from tests.io.formats.test_read import same

MODELS = {
    "bundler": ["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"],
    "nvm": ["SIMPLE_PINHOLE"],
    "opensfm": [
        *("RADIAL", "OPENCV", "RADIAL_FISHEYE", "OPENCV_FISHEYE", "SIMPLE_FISHEYE"),
        "THIN_PRISM_FISHEYE",
    ],
    "openmvg": ["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE"],
}
NAMES = {"bundler": "m.out", "nvm": "m.nvm", "opensfm": "project", "openmvg": "sfm_data.json"}
CASES = [(name, model) for name, models in MODELS.items() for model in models]


def one_focal(problem: bundle.Problem) -> bundle.Problem:
    if "fy" not in bundle.camera_models()[problem.camera_models[0]]:
        return problem
    params = problem.camera_params.copy()
    params[:, 1] = params[:, 0]
    return problem.replace(camera_params=params)


def colored(problem, folder) -> bundle.Problem:
    """The problem as read from a COLMAP model with colours."""
    reconstruction = problem.to_pycolmap()
    for number, point in reconstruction.points3D.items():
        point.color = np.array([number % 256, 3 * number % 256, 7])
    folder.mkdir()
    reconstruction.write(folder)
    return bundle.load(folder)


@pytest.mark.parametrize(("name", "model"), CASES)
def test_colmap_to_x_to_colmap(tmp_path, name, model) -> None:
    truth = colored(one_focal(small(model)), tmp_path / "sparse")
    lost = bundle.save(truth, tmp_path / NAMES[name], name)
    problem = bundle.load(tmp_path / NAMES[name], image_size=(800, 600))
    if name in ("bundler", "nvm"):
        assert any("shared" not in sentence for sentence in lost)
    same(problem, truth)
    assert problem.image_names == truth.image_names
    bundle.save(problem, tmp_path / "again", "colmap")
    again = bundle.load(tmp_path / "again").to_pycolmap()
    first = truth.to_pycolmap()
    for number, other in zip(problem.point_ids.tolist(), truth.point_ids.tolist(), strict=True):
        color = (0, 0, 0) if name == "openmvg" else tuple(first.point3D(other).color)
        assert tuple(again.point3D(number).color) == color
        assert len(again.point3D(number).track.elements) == 3
    if name == "openmvg":
        assert any("Colours" in sentence for sentence in lost)
        assert problem.point_ids.tolist() == truth.point_ids.tolist()


@pytest.mark.parametrize("name", list(NAMES))
def test_what_was_written_and_read_is_written_alike(tmp_path, name) -> None:
    """The second file equals the first, but for the last bits of products."""
    truth = small(MODELS[name][-1] if name != "openmvg" else "RADIAL")
    for step in ("one", "two"):
        (tmp_path / step).mkdir()
        bundle.save(truth, tmp_path / step / NAMES[name], name)
        truth = bundle.load(tmp_path / step / NAMES[name], image_size=(800, 600))
    files = [
        sorted(p for p in (tmp_path / step).rglob("*") if p.is_file()) for step in ("one", "two")
    ]
    assert [p.name for p in files[0]] == [p.name for p in files[1]]
    for first, second in zip(*files, strict=True):
        texts = [path.read_text().replace(",", " ").split() for path in (first, second)]
        for a, b in zip(*texts, strict=True):
            try:
                assert float(a.strip("[]{}")) == pytest.approx(float(b.strip("[]{}")), abs=1e-10)
            except ValueError:
                assert a == b


def test_bundler_keeps_images_that_are_not_registered(tmp_path) -> None:
    from tests.io.formats import foreign_files as foreign

    foreign.write_bundler(small(), tmp_path / "a.out", unregistered=(0, 3), names="abcdef")
    problem = bundle.load(tmp_path / "a.out", image_size="unknown")
    (tmp_path / "new").mkdir()
    bundle.save(problem, tmp_path / "new" / "b.out")
    assert (tmp_path / "new" / "list.txt").read_text().split() == list("abcdef")
    again = bundle.load(tmp_path / "new" / "b.out", image_size="unknown")
    assert again.image_ids.tolist() == [1, 2, 4, 5]
    same(again, problem)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "list.txt").write_text("mine.jpg\n")
    with pytest.raises(bundle.InputError, match=r"expected a folder without list.txt"):
        bundle.save(problem, tmp_path / "other" / "b.out")
    assert [p.name for p in (tmp_path / "other").iterdir()] == ["list.txt"]


def test_nvm_fits_the_distortion_and_keeps_its_own(tmp_path) -> None:
    lens = [800.0, 400.0, 300.0, -0.05, 0.01]
    truth = small("RADIAL", noise=0.0, perturbation=0.0, camera_params=np.tile(lens, (4, 1)))
    lost = bundle.save(truth, tmp_path / "a.nvm")
    assert "largest error" in lost[-1]
    problem = bundle.load(tmp_path / "a.nvm", image_size=(800, 600))
    assert problem.source.source_rmse < 0.5
    bundle.save(problem, tmp_path / "b.nvm")
    words = [(tmp_path / name).read_text().split("\n")[3].split()[9] for name in ("a.nvm", "b.nvm")]
    assert words[0] == words[1]


@pytest.mark.parametrize("name", ["bundler", "nvm", "openmvg", "opensfm", "transforms"])
def test_lenses_that_a_format_lacks_are_refused(tmp_path, name) -> None:
    model = {"bundler": "OPENCV_FISHEYE", "opensfm": "FOV"}.get(name, "THIN_PRISM_FISHEYE")
    problem = small(model)
    with pytest.raises(bundle.InputError, match="cannot hold it"):
        bundle.save(problem, tmp_path / "out", name)
    assert not list(tmp_path.iterdir())


def test_rigs_go_through_opensfm(bundle_data, tmp_path) -> None:
    problem = bundle.load(bundle_data / "rigs/kitti26_stereo_rig")
    bundle.save(problem, tmp_path / "p", "opensfm")
    again = bundle.load(tmp_path / "p")
    assert (again.num_frames, again.num_sensors) == (problem.num_frames, problem.num_sensors)
    assert again.num_observations == problem.num_observations
    errors = [np.sqrt(np.mean(bundle.reprojection_errors(p)[0] ** 2)) for p in (problem, again)]
    assert errors[0] == pytest.approx(errors[1], abs=1e-9)


def test_opensfm_keeps_gps_scales_and_names(bundle_data, tmp_path) -> None:
    problem = bundle.load(bundle_data / "formats/opensfm_berlin")
    bundle.save(problem, tmp_path / "p")  # no suffix: the format of the input
    one = json.loads((bundle_data / "formats/opensfm_berlin/reconstruction.json").read_text())[0]
    two = json.loads((tmp_path / "p/reconstruction.json").read_text())[0]
    assert one["reference_lla"] == two["reference_lla"] and list(one["cameras"]) == list(
        two["cameras"]
    )
    assert one["shots"]["01.jpg"]["gps_position"] == two["shots"]["01.jpg"]["gps_position"]
    line = next(
        x for x in (tmp_path / "p/tracks.csv").read_text().split("\n") if "02.jpg\t1479\t" in x
    )
    assert [float(x) for x in line.split("\t")[2:9]] == pytest.approx(
        [2594, 0.0379803, -0.0481853, 0.00155505, *(two["points"]["1479"]["color"])], abs=1e-12
    )


def test_transforms_in_opengl_axes(tmp_path) -> None:
    """A point in front of the camera projects by nerfstudio's convention to the same pixel."""
    problem = small("OPENCV")
    lost = bundle.save(problem, tmp_path / "transforms.json")
    assert "cameras only" in lost[0]
    content = json.loads((tmp_path / "transforms.json").read_text())
    assert content["camera_model"] == "OPENCV"
    for image, frame in enumerate(content["frames"]):
        matrix = np.linalg.inv(np.array(frame["transform_matrix"]))
        inside = problem.points @ matrix[:3, :3].T + matrix[:3, 3]
        assert (inside[:, 2] < 0).all()  # OpenGL looks along -z
        x, y = inside[:, 0] / -inside[:, 2], -inside[:, 1] / -inside[:, 2]
        r2 = x * x + y * y
        k1, k2, p1, p2 = (frame[name] for name in ("k1", "k2", "p1", "p2"))
        radial = 1 + k1 * r2 + k2 * r2 * r2
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        pixels = np.stack([frame["fl_x"] * u + frame["cx"], frame["fl_y"] * v + frame["cy"]], 1)
        mine = problem.observation_image == image
        expected, _ = bundle.reprojection_errors(problem)
        residual = pixels[problem.observation_point[mine]] - problem.observation_xy[mine]
        np.testing.assert_allclose(np.linalg.norm(residual, axis=1), expected[mine], atol=1e-8)


def test_ply_has_points_and_frusta(tmp_path) -> None:
    import pycolmap

    problem = colored(small(), tmp_path / "sparse")
    bundle.save(problem, tmp_path / "cloud.ply")
    data = (tmp_path / "cloud.ply").read_bytes()
    header, body = data.split(b"end_header\n", 1)
    assert b"element vertex 50\n" in header and b"element edge 32\n" in header
    kinds = [("xyz", "<3f4"), ("rgb", "3u1"), ("error", "<f4"), ("views", "<f4")]
    vertices = np.frombuffer(body, kinds, 50)
    np.testing.assert_allclose(vertices["xyz"][:30], problem.points, rtol=1e-6)
    np.testing.assert_allclose(vertices["xyz"][30::5], problem.projection_centers, rtol=1e-5)
    assert (vertices["views"] == [3] * 30 + [0] * 20).all()
    assert vertices["rgb"][4].tolist() == [5, 15, 7]
    reconstruction = problem.to_pycolmap()
    reconstruction.update_point_3d_errors()
    expected = [reconstruction.point3D(number).error for number in problem.point_ids.tolist()]
    np.testing.assert_allclose(vertices["error"][:30], expected, rtol=1e-5)
    cloud = pycolmap.Reconstruction()
    cloud.import_PLY(str(tmp_path / "cloud.ply"))
    assert cloud.num_points3D() == 50


@pytest.mark.parametrize("is_apart", [False, True])
def test_a_format_of_another_package(is_apart, tmp_path, monkeypatch) -> None:
    """An entry point adds a format, with reader and writer in one module or in two."""
    import importlib.metadata
    from types import SimpleNamespace

    truth = small()

    def write(problem, path) -> tuple[str, ...]:
        path.write_text(f"MY FORMAT {problem.num_images}")
        return ("All but a count is left out.",)

    mine = bundle.Format(
        name="mine",
        what="a file of mine",
        module=SimpleNamespace(read=lambda *_: truth, **({} if is_apart else {"write": write})),
        writer=SimpleNamespace(write=write) if is_apart else None,
        pattern=rb"MY FORMAT",
    )
    entry = SimpleNamespace(name="mine", load=lambda: mine)
    monkeypatch.setattr(
        importlib.metadata,
        "entry_points",
        lambda group: [entry] if group == "bundle.formats" else [],
    )
    assert bundle.save(truth, tmp_path / "x", "mine") == ("All but a count is left out.",)
    assert bundle.load(tmp_path / "x") is truth
    entry.load = lambda: 5
    with pytest.raises(bundle.InputError, match=r"expected a bundle.Format, found int"):
        bundle.load(tmp_path / "x")


def test_an_edit_is_written(tmp_path) -> None:
    """Deleted observations and points, and a moved camera, in every format."""
    truth = small()
    edited = truth.select(points=truth.points[:, 0] > 0).problem
    edited = scenes.with_observations(edited, np.arange(edited.num_observations) % 5 > 0)
    for name, path in NAMES.items():
        bundle.save(edited, tmp_path / path, name)
        problem = bundle.load(tmp_path / path, image_size=(800, 600))
        assert problem.num_points == edited.num_points
        assert problem.num_observations == edited.num_observations
