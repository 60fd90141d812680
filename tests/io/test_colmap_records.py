"""Models written record by record: byte for byte what pycolmap writes of what it reads."""

import dataclasses
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import bundle
from bundle import Problem
from bundle.io import colmap
from bundle.model.cameras import param_kinds
from tests.io.colmap_models import errors_of, fields, synthesize, write_model
from tests.io.test_editing import EDITS, SOURCES, expect_same, rows
from tests.io.test_rig_models import extended, without_images
from tests.rig_scenes import FIVE, STEREO, rig_problem

BOTH = pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
NAMES = ("a.jpg", "two words.png", "äöü/ß.jpg", "日本/01.jpg", "#", "-1", "a" * 300)


def drawn(seed: int) -> Problem:
    """Draw a problem from memory: any lens, any ids, images and points without observations."""
    rng = np.random.default_rng(seed)
    num_cameras, num_images, num_points = rng.integers(1, 5), rng.integers(1, 8), rng.integers(0, 9)
    models = rng.choice(list(bundle.camera_models()), num_cameras).tolist()
    params = np.zeros((num_cameras, 16))
    for row, model in zip(params, models, strict=True):
        kinds = param_kinds(model)
        row[: len(kinds)] = [
            rng.uniform(500, 900) if kind in ("focal", "metadata") else rng.normal(0, 1e-3)
            for kind in kinds
        ]
    seen = rng.random((num_images, num_points)) < rng.choice([0, 0.5, 1])
    image, point = np.nonzero(seen)
    order = rng.permutation(len(image))
    poses = rng.normal(size=(num_images, 7))
    largest = rng.choice([50, 2**31, 2**32 - 2])
    return Problem(
        cam_from_world=poses,
        image_ids=np.sort(largest - rng.choice(50, num_images, replace=False)),
        image_names=rng.choice([*NAMES, ""], num_images).tolist(),
        image_camera=rng.integers(0, num_cameras, num_images),
        camera_ids=largest - rng.choice(50, num_cameras, replace=False),
        camera_models=models,
        camera_params=params,
        camera_sizes=rng.integers(0, 5000, (num_cameras, 2)),
        points=rng.normal(size=(num_points, 3)) * 10.0 ** rng.integers(-3, 9),
        point_ids=2 ** rng.choice([8, 40, 63]).astype(object)
        - 1
        - rng.choice(200, num_points, replace=False),
        observation_image=image[order],
        observation_point=point[order],
        observation_xy=rng.normal(0, 300, (len(image), 2)),
    )


def models() -> Iterator[tuple[str, Problem]]:
    """Yield problems of every kind: drawn ones, rigs, edits of models that pycolmap made."""
    for seed in range(25):
        yield f"drawn {seed}", drawn(seed)
    for kind in (STEREO, FIVE):
        yield "rig", rig_problem(rigs=(kind,))
    yield "two rigs", rig_problem(rigs=(STEREO, FIVE))
    source = Problem.from_pycolmap(extended())
    yield "sensors of all kinds", source
    yield "moved points", source.replace(points=source.points + 0.1)
    yield "no rigs", source.without_rigs()
    yield (
        "fewer observations",
        source.replace(**rows(source, np.arange(source.num_observations) % 3 > 0)),
    )


MODELS = dict(models())


def saved(problem: Problem, folder: Path, *, binary: bool) -> Path:
    folder.mkdir()
    colmap.write(problem, folder, binary=binary)
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@BOTH
@pytest.mark.parametrize("name", MODELS)
def test_files_are_those_that_pycolmap_writes(tmp_path: Path, name: str, binary: bool) -> None:
    problem = MODELS[name]
    if not binary and problem.format == "colmap" and not all(problem.image_names):
        pytest.skip("text needs names")
    ours = saved(problem, tmp_path / "ours", binary=binary)
    oracle = pycolmap.Reconstruction(ours)
    if not binary:  # pycolmap reads the first word of a name
        names = bundle.load(ours).image_names
        for image_id, image_name in zip(sorted(oracle.images), names, strict=True):
            oracle.image(image_id).name = image_name
    theirs = write_model(oracle, tmp_path / "theirs", binary=binary)
    assert files_of(ours) == files_of(theirs)


@BOTH
@pytest.mark.parametrize("source", ["binary", "text", "bal"])
def test_edits_in_a_row_are_in_the_files(tmp_path: Path, source: str, binary: bool) -> None:
    rng = np.random.default_rng(len(source))
    start = SOURCES[source](tmp_path)
    fields = sorted(set(EDITS) - {"source", "image_ids", "observation_sigma"})
    for draw in range(12):
        problem = start
        for field in rng.choice(fields, 3).tolist():
            edit = EDITS[field][str(rng.choice(list(EDITS[field])))]
            changes = edit(problem)
            if problem.num_observations:
                problem = dataclasses.replace(problem, **changes)
        ours = saved(problem, tmp_path / str(draw), binary=binary)
        if not binary and any(" " in name for name in problem.image_names):
            continue  # pycolmap reads the first word
        expect_same(
            problem, pycolmap.Reconstruction(ours), colmap.write(problem, ours, binary=binary)
        )


@pytest.mark.parametrize("model", bundle.camera_models())
def test_errors_of_points_are_pycolmaps(tmp_path: Path, model: str) -> None:
    """Also behind a camera, beyond 90 degrees, and with quaternions that are not of norm 1."""
    problem = Problem.from_pycolmap(synthesize(5, model="SIMPLE_PINHOLE", num_points=60))
    kinds = param_kinds(model)
    values = {"focal": 700.0, "metadata": 1024.0, "principal-point": 400.0}
    params = [values.get(kind, 0.01) for kind in kinds]
    scales = np.linspace(0.9, 1.1, problem.num_images)[:, None] ** [1, 1, 1, 1, 0, 0, 0]
    problem = problem.replace(
        camera_models=[model] * problem.num_cameras,
        camera_params=np.tile(params, (problem.num_cameras, 1)),
        cam_from_world=problem.cam_from_world * scales,
        points=problem.points * np.linspace(0.1, 9, problem.num_points)[:, None],
    )
    ours = pycolmap.Reconstruction(saved(problem, tmp_path / "ours", binary=True))
    theirs = pycolmap.Reconstruction(ours)
    theirs.update_point_3d_errors()
    expected = errors_of(theirs)
    assert errors_of(ours) == {i: pytest.approx(e, rel=1e-9) for i, e in expected.items()}
    assert min(expected.values()) > 0


def test_images_stand_in_the_order_of_registration(tmp_path: Path) -> None:
    source = synthesize(6)
    for frame_id in (3, 1):
        pose = source.frame(frame_id).rig_from_world
        source.deregister_frame(frame_id)
        source.frame(frame_id).rig_from_world = pose
        source.register_frame(frame_id)
    theirs = write_model(source, tmp_path / "theirs", binary=True)
    ours = saved(Problem.from_pycolmap(source), tmp_path / "ours", binary=True)
    assert files_of(ours)["images.bin"] == files_of(theirs)["images.bin"]
    assert list(source.reg_image_ids())[-2:] == [3, 1]


def images_in(problem: Problem, folder: Path) -> list[int]:
    """Return the ids of the images in the order of the file."""
    text = (saved(problem, folder, binary=False) / "images.txt").read_text()
    lines = [line for line in text.split("\n") if not line.startswith("#")]
    return [int(line.split()[0]) for line in lines[::2] if line]


def test_images_that_change_frames_stand_last(tmp_path: Path) -> None:
    """COLMAP registers their frames anew."""
    source = synthesize(6)
    full = Problem.from_pycolmap(source)
    ids = full.image_ids.tolist()
    camera = full.image_camera.copy()
    camera[2] = 1 - camera[2]
    moved = full.replace(image_camera=camera)
    assert images_in(moved, tmp_path / "moved") == [*ids[:2], *ids[3:], ids[2]]
    source.deregister_frame(source.image(ids[4]).frame_id)
    registered = full.replace(source=source)
    assert images_in(registered, tmp_path / "new") == [*ids[:4], *ids[5:], ids[4]]


def test_frames_that_lose_an_image_are_registered_by_id(tmp_path: Path) -> None:
    source = extended()
    pose = source.frame(1).rig_from_world
    source.deregister_frame(1)
    source.frame(1).rig_from_world = pose
    source.register_frame(1)
    problem = Problem.from_pycolmap(source)
    order = [i for frame in source.reg_frame_ids() for i in images_of(source, frame)]
    assert images_in(problem, tmp_path / "all") == order != sorted(order)
    gone = int(np.flatnonzero(problem.image_ids == images_of(source, 2)[0])[0])
    left = [i for i in sorted(order) if i != images_of(source, 2)[0]]
    assert images_in(without_images(problem, [gone]), tmp_path / "left") == left


def images_of(source: pycolmap.Reconstruction, frame_id: int) -> list[int]:
    return [datum.id for datum in source.frame(frame_id).image_ids]


def test_tracks_keep_their_order(tmp_path: Path) -> None:
    source = synthesize(6)
    problem = Problem.from_pycolmap(source)
    for point in source.points3D.values():
        point.track = pycolmap.Track(point.track.elements[::-1])
    order = np.random.default_rng(0).permutation(problem.num_observations)
    shuffled = Problem.from_pycolmap(source).replace(**rows(problem, order))
    written = pycolmap.Reconstruction(saved(shuffled, tmp_path / "out", binary=True))
    assert fields(written)["points"] == fields(source)["points"]


def test_errors_that_are_not_finite_are_not_known_in_text(tmp_path: Path) -> None:
    problem = Problem.from_pycolmap(synthesize(7))
    signs = np.random.default_rng(0).choice([-1e308, 1e308], problem.points.shape)
    far = problem.replace(points=signs)
    binary = pycolmap.Reconstruction(saved(far, tmp_path / "binary", binary=True))
    text = pycolmap.Reconstruction(saved(far, tmp_path / "text", binary=False))
    assert not np.isfinite(list(errors_of(binary).values())).all()
    for point_id, error in errors_of(binary).items():
        assert errors_of(text)[point_id] == (error if np.isfinite(error) else -1)


WITHOUT_PYCOLMAP = """
import sys, bundle
from pathlib import Path
folder, out = map(Path, sys.argv[1:])
problem = bundle.load(folder)
kept = problem.observation_keypoint % 3 > 0
names = ("image", "point", "xy", "keypoint")
edited = problem.replace(
    **{f"observation_{name}": getattr(problem, f"observation_{name}")[kept] for name in names}
)
for format in ("colmap", "colmap-text"):
    bundle.save(edited, out / format, format)
    bundle.save(edited.replace(source=None), out / f"new-{format}", format)
assert "pycolmap" not in sys.modules
"""


@BOTH
def test_edits_are_written_without_pycolmap(tmp_path: Path, binary: bool) -> None:
    """Its import takes longer than the writing."""
    folder = write_model(extended(), tmp_path / "in", binary=binary)
    (tmp_path / "out").mkdir()
    command = [sys.executable, "-c", WITHOUT_PYCOLMAP, str(folder), str(tmp_path / "out")]
    subprocess.run(command, check=True)
    assert len(list((tmp_path / "out").iterdir())) == 4


KILLED = """
import resource, signal, sys, bundle
problem = bundle.load(sys.argv[1]).replace(source=None)
signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
size = int(sys.argv[3])
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
bundle.save(problem, sys.argv[2], "colmap-text")
"""


def test_a_kill_in_any_file_leaves_the_old_model(tmp_path: Path) -> None:
    """The kernel kills a writer whose file exceeds RLIMIT_FSIZE."""
    folder = write_model(synthesize(8), tmp_path / "in", binary=True)
    target = write_model(synthesize(9), tmp_path / "out", binary=False)
    before = files_of(target)
    for size in (100, 900, 3000):
        command = [sys.executable, "-c", KILLED, str(folder), str(target), str(size)]
        killed = subprocess.run(command, check=False, capture_output=True)
        assert killed.returncode == -signal.SIGXFSZ
        assert files_of(target) == before
    bundle.save(bundle.load(folder), target, "colmap-text")  # and the next one clears up
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in", "out"]


def test_an_interrupt_ends_the_writing(tmp_path: Path) -> None:
    """A pipe in place of a file: the reader interrupts after the first block of many."""
    count = 100_000
    problem = Problem(
        cam_from_world=[[0, 0, 0, 1, 0, 0, 5]],
        camera_models=["SIMPLE_PINHOLE"],
        camera_params=[[500.0, 0, 0]],
        points=np.random.default_rng(0).normal(size=(count, 3)),
        observation_image=np.zeros(count, int),
        observation_point=np.arange(count),
        observation_xy=np.random.default_rng(1).normal(size=(count, 2)),
    )
    os.mkfifo(tmp_path / "images.txt")

    def read() -> None:
        with (tmp_path / "images.txt").open("rb") as pipe:
            pipe.read(1)
            signal.raise_signal(signal.SIGINT)
            while pipe.read(1 << 20):
                pass

    reader = threading.Thread(target=read)
    reader.start()
    with pytest.raises(KeyboardInterrupt):
        colmap.write(problem, tmp_path, binary=False)
    reader.join()
    assert not (tmp_path / "points3D.txt").exists()
