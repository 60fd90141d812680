"""The files that the code blocks of the documents name, made small."""

from __future__ import annotations

import bz2
import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

import bundle
from bundle.georeference.local_frame import LocalFrame
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.io.sequences.trajectory_files import load_trajectory
from bundle.model.rigid_motions import inverse_poses, multiply_poses, rotation_matrices
from bundle.reports.sections import dumps
from bundle.reports.terminal.compare import compared
from tests.editing.merging.halves import halves, whole
from tests.figures.matplotlib.comparisons import comparison
from tests.georeference.test_exif_gps import photo
from tests.graphs.loops.drift import closures_of, drifted_street
from tests.inertial.images.other_forms import write_bag, write_kalibr, write_video
from tests.inertial.images.rendered_flight import SMALL, Flight, render
from tests.io.formats import foreign_files as foreign
from tests.io.formats import learned_exports
from tests.track_scenes import write_database

REPOSITORY = Path(__file__).parents[2]
FRAME = LocalFrame(45.15, 9.0, 100.0)
METRES = 20.0  # per unit of the model


def base(folder: Path) -> None:
    """sparse/0 with what is known of it: geo.txt, gcp_list.txt, points.csv, marks.csv, markers.xml,
    bars.txt, gravity.txt, images, photos, rules.txt; data.

    30 images of a camera each: ids from 1 and from 120, some in left/ and some in new/.
    """
    scene = bundle.synthesize(
        scene="orbit", num_images=30, num_points=300, mean_track_length=6, seed=1,
        camera_model="SIMPLE_RADIAL", cameras="individual",
    )  # fmt: skip
    ids = [*range(1, 10), *range(120, 141)]
    names = [f"{'left' if i < 7 else 'new' if i > 135 else 'right'}/{i:03}.jpg" for i in ids]
    changes = {"image_ids": np.array(ids), "image_names": names}
    problem, truth = scene.problem.replace(**changes), scene.ground_truth.replace(**changes)
    (folder / "sparse").mkdir()
    bundle.save(problem, folder / "sparse" / "0", "colmap")
    bundle.save(truth, folder / "sparse" / "last_year", "colmap")
    (folder / "data").symlink_to(REPOSITORY / "data")
    (folder / "project.ini").write_text("[BundleAdjustment]\nrefine_principal_point=1\n")
    (folder / "rules.txt").write_text("cameras *: f prior 2 %  # of the lens\n")

    places = FRAME.to_geodetic(METRES * truth.projection_centers).tolist()
    lines = [f"{name} {lon!r} {lat!r} {h!r}" for name, (lat, lon, h) in zip(names, places)]  # noqa: B905
    (folder / "geo.txt").write_text("\n".join(["EPSG:4326", *lines, ""]))
    for name, (lat, lon, h) in zip(names, places, strict=True):
        tags = {1: "N", 2: degrees(lat), 3: "E", 4: degrees(lon), 5: b"\0", 6: h}
        photo(folder / "images" / name, tags)
    shutil.copytree(folder / "images", folder / "photos")
    marks = targets(truth)
    (folder / "gcp_list.txt").write_text("\n".join(["EPSG:4326", *marks, ""]))
    words = [line.split() for line in marks]
    points = dict.fromkeys(f"{name},{lon},{lat},{h}" for lon, lat, h, *_, name in words)
    (folder / "points.csv").write_text("\n".join(["label,lon,lat,alt", *points, ""]))
    lines = [f"{image},{name},{x},{y}" for *_, x, y, image, name in words]
    (folder / "marks.csv").write_text("\n".join([*lines, ""]))
    (folder / "markers.xml").write_text(markers(names, words))
    centers = METRES * truth.projection_centers
    bars = [
        f"{names[a]} {names[b]} {np.linalg.norm(centers[a] - centers[b]):.6f}"
        for a, b in ((0, 8), (9, 20), (14, 29))
    ]
    (folder / "bars.txt").write_text("\n".join([*bars, ""]))
    rng = np.random.default_rng(3)
    downs = -rotation_matrices(truth.cam_from_world[:, :4])[:, :, 2]
    downs += np.radians(1) * rng.standard_normal(downs.shape)
    rows = zip(names, downs.tolist(), strict=True)
    lines = [f"{name} {x:.5f} {y:.5f} {z:.5f} 1.0" for name, (x, y, z) in rows]
    (folder / "gravity.txt").write_text("\n".join([*lines, ""]))


def video(folder: Path) -> None:
    """sparse/0 of a film, the times of its frames and the positions of the camera."""
    scene = bundle.synthesize(
        scene="orbit", num_images=20, num_points=400, rolling_shutter=0.8, seed=4
    )  # fmt: skip
    truth = scene.ground_truth
    (folder / "sparse").mkdir()
    bundle.save(scene.problem, folder / "sparse" / "0", "colmap")
    frames = [f"{image},{k}" for k, image in enumerate(truth.image_ids.tolist())]
    (folder / "frames.csv").write_text("\n".join(["image_id,frame", *frames, ""]))
    places = FRAME.to_geodetic(METRES * truth.projection_centers).tolist()
    lines = [
        f"{name} {lon!r} {lat!r} {h!r}"
        for name, (lat, lon, h) in zip(truth.image_names, places, strict=True)
    ]
    (folder / "positions.txt").write_text("\n".join(["EPSG:4326", *lines, ""]))
    along = truth.rolling_shutter.twist[:, 3:].copy()
    turns = Rotation.from_quat(truth.cam_from_world[:, :4].copy()).inv()
    speeds = (-METRES * 30 / 0.6 * turns.apply(along)).tolist()
    rows = [
        f"{n} {x!r} {y!r} {z!r}" for n, (x, y, z) in zip(truth.image_names, speeds, strict=True)
    ]
    (folder / "velocities.csv").write_text("\n".join(["name vx vy vz", *rows, ""]))


def degrees(value: float) -> tuple[float, float, float]:
    """Degrees, minutes and seconds."""
    minutes, seconds = divmod(value * 3600, 60)
    return (*map(float, divmod(minutes, 60)), seconds)


def targets(truth: bundle.Problem) -> list[str]:
    """Lines of a gcp_list.txt: six points far from each other, as the images saw them."""
    seen = np.bincount(truth.observation_point)
    order = np.argsort(truth.points @ [1.0, 0.3, 0.1])
    chosen = order[seen[order] > 3][np.linspace(0, (seen > 3).sum() - 1, 6).astype(int)]
    lines = []
    for number, point in enumerate(chosen.tolist(), start=4):
        lat, lon, h = FRAME.to_geodetic(METRES * truth.points[point])[0].tolist()
        for row in np.flatnonzero(truth.observation_point == point):
            x, y = (truth.observation_xy[row] - 0.5).tolist()
            name = truth.image_names[truth.observation_image[row]]
            lines.append(f"{lon!r} {lat!r} {h!r} {x!r} {y!r} {name} gcp{number:02}")
    return lines


def markers(images: list[str], marks: list[list[str]]) -> str:
    """Metashape's XML of the marks; words of a line are x y z px py image label."""
    known = {words[-1]: words for words in marks}
    parts = ["<document><chunk><cameras>"]
    parts += [f'<camera id="{row}" label="{name}"/>' for row, name in enumerate(images)]
    parts += ["</cameras><markers>"]
    for name, (x, y, z, *_) in known.items():
        place = f'<reference x="{x}" y="{y}" z="{z}" enabled="true"/>'
        parts += [f'<marker id="{name}" label="{name}">{place}</marker>']
    parts += ["</markers><frames><frame><markers>"]
    for *_, x, y, image, name in marks:
        place = f'camera_id="{images.index(image)}" x="{float(x) + 0.5}" y="{float(y) + 0.5}"'
        parts += [f'<marker marker_id="{name}"><location {place}/></marker>']
    system = 'GEOGCS["WGS 84",AUTHORITY["EPSG","4326"]]'
    parts += [f"</markers></frame></frames><reference>{system}</reference></chunk></document>"]
    return "\n".join(parts)


def other_programs(folder: Path, _data: Path) -> None:
    """Files of Bundler with its photographs, Metashape, VisualSFM, OpenSfM, VGGT and others."""
    own = foreign.small(num_points=60)
    names = [f"photos/{index}.jpg" for index in range(4)]
    for name in (
        *("bundler/photos", "nerf", "mvg_out", "metashape", "realitycapture"),
        *("vggt", "mast3r"),
    ):
        (folder / name).mkdir(parents=True)
    for name in names:
        Image.new("L", (800, 600)).save(folder / "bundler" / name)
    foreign.write_bundler(own, folder / "bundler" / "bundle.out", names=names)
    foreign.write_metashape(own, folder / "metashape")
    foreign.write_realitycapture(own, folder / "realitycapture")
    foreign.write_nvm(foreign.small("SIMPLE_PINHOLE", num_points=60), folder / "model.nvm")
    foreign.write_opensfm(own, folder / "opensfm")
    foreign.write_openmvg(own, folder / "sfm_data.json")
    foreign.write_database(own.image_names, folder / "database.db")
    images = learned_exports.truth(0)
    bundle.save(learned_exports.export(images, "single", 5), folder / "vggt" / "sparse")
    bundle.save(learned_exports.export(images, "pairs", 5), folder / "mast3r" / "sparse")


def measured(folder: Path, _data: Path) -> None:
    """report.json, a comparison of solvers."""
    (folder / "report.json").write_text(dumps(compared(comparison(1)).json()))


def two_pieces(folder: Path) -> None:
    """sparse/0 and sparse/1, two models with images in common."""
    (folder / "sparse").mkdir()
    for number, model in enumerate(halves(whole())):
        bundle.save(model, folder / "sparse" / str(number), "colmap")


def graphs(folder: Path, data: Path) -> None:
    """Pose graphs of the benchmarks, and a drive that has drifted with closures."""
    for name in ("sphere2500", "MIT"):
        packed = (data / "g2o" / f"{name}.g2o.bz2").read_bytes()
        (folder / f"{name}.g2o").write_bytes(bz2.decompress(packed))
    for name in ("parking-garage", "smallGrid3D"):
        shutil.copy(data / "g2o" / f"{name}.g2o.bz2", folder)
    truth, drifted, scales = drifted_street(num_images=40, num_points=600)
    bundle.save(drifted, folder / "drifted", "colmap")
    bundle.save(closures_of(truth, scales), folder / "closures.g2o")


def sequence(folder: Path, data: Path) -> None:
    """The first nine seconds of EuRoC's V1_01, its truth, and a closure, as the truth has it."""
    name = "euroc_V1_01_tracks_imu_30s.csv"
    lines = (data / "vio" / name).read_text().splitlines(keepends=True)
    times = [line.split(",", 3)[2] for line in lines]
    early = [line for line, time in zip(lines[1:], times[1:], strict=True) if float(time or 0) < 9]
    (folder / name).write_text("".join([lines[0], *early]))
    shutil.copy(data / "vio" / "euroc_V1_01_ground_truth.csv", folder / "truth.csv")
    truth = load_trajectory(folder / "truth.csv")
    stamps = truth.timestamps_ns[0] + np.array([5_500_000_000, 8_000_000_000])
    ends = states_at(truth, stamps)[:, :7]
    pose = multiply_poses(inverse_poses(ends[:1]), ends[1:])[0]
    numbers = [*stamps.tolist(), *pose[4:].tolist(), *pose[:4].tolist(), 0.01, 0.1]
    (folder / "closures.csv").write_text(",".join(map(str, numbers)) + "\n")
    images(folder)


def images(folder: Path) -> None:
    """mav0, two seconds of a rendered flight, as a bag and as a video; Kalibr's calibration."""
    mav = render(Flight(duration=2.0, **SMALL), folder)
    write_kalibr(mav)
    write_bag(mav, folder / "flight.bag", 1)
    write_video(mav)


def photographs(folder: Path, data: Path) -> None:
    """Eight photographs of a crane."""
    (folder / "crane_mast").symlink_to(data / "colmap" / "crane_mast")


def tracked(folder: Path, data: Path) -> None:
    """The crane; a database of the model's matches; the model with two thirds of its tracks."""
    photographs(folder, data)
    problem = bundle.load(folder / "sparse" / "0")
    write_database(problem, folder / "database.db")
    (folder / "cut").mkdir()
    some = np.arange(problem.num_observations) % 3 > 0
    bundle.save(problem.select(observations=some).problem, folder / "cut" / "0", "colmap")


def one_flight(folder: Path, data: Path) -> None:
    """The flight over control points."""
    (folder / "copr_gcp").symlink_to(data / "georeferenced" / "copr_gcp")


def flights(folder: Path, data: Path) -> None:
    """The two flights of the drone block."""
    georeferenced = data / "georeferenced"
    (folder / "brighton").symlink_to(georeferenced / "brighton_gps" / "model")
    (folder / "copr").symlink_to(georeferenced / "copr_gcp" / "model")
    gcps = folder / "gcp_list.txt"
    gcps.unlink(missing_ok=True)
    gcps.symlink_to(georeferenced / "copr_gcp" / "gcp_list.txt")
    places = json.loads((georeferenced / "brighton_gps" / "lla.json").read_text())
    wrong = dict(places)
    east = LocalFrame(*places["DJI_0025.JPG"]).to_geodetic([30.0, 0.0, 0.0])[0]
    wrong["DJI_0025.JPG"] = east.tolist()
    for name, table in (("geo.txt", places), ("wrong.txt", wrong)):
        lines = [f"{image} {lon!r} {lat!r} {h!r}" for image, (lat, lon, h) in table.items()]
        (folder / name).write_text("\n".join(["EPSG:4326", *lines, ""]))
