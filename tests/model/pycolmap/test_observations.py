"""Observations of images and tracks: from files that pycolmap writes, or from its objects."""

import os
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from bundle.model.pycolmap import adjustment_objects
from bundle.model.pycolmap import reconstruction as module
from bundle.model.pycolmap.reconstruction import Observations, observations_and_tracks, small_model
from tests.solving.colmap_adjustment.option_space import images_alone, rigs


def images_of(model):
    return [model.image(key) for key in sorted(model.reg_image_ids())]


def from_objects(images):
    """Return image, keypoint, point id and pixel of each observation, one object at a time."""
    rows = [
        (row, index, image.point2D(index).point3D_id, *image.point2D(index).xy)
        for row, image in enumerate(images)
        for index in range(image.num_points2D())
        if image.point2D(index).has_point3D()
    ]
    image, keypoint, point_id = (np.array(column) for column in list(zip(*rows, strict=True))[:3])
    return image, keypoint, point_id, np.array([row[3:] for row in rows])


def check(images, points=()):
    """Compare observations and tracks with those of one object at a time."""
    found, elements = observations_and_tracks(images, list(points))
    columns = found.image, found.keypoints(), found.point_id, found.xy
    for column, expected in zip(columns, from_objects(images), strict=True):
        assert (column == expected).all()
    expected = [
        [element.image_id, element.point2D_idx, row]
        for row, point in enumerate(points)
        for element in point.track.elements
    ]
    assert sorted(elements.tolist()) == sorted(expected)


@pytest.fixture
def files_read(monkeypatch):
    """Numbers of images found in files, and nothing left of the files afterwards."""
    read, found = module._keypoints_in, []

    def counted(*arguments):
        records = read(*arguments)
        found.append(len(records))
        return records

    monkeypatch.setattr(module, "_keypoints_in", counted)
    yield found
    assert not list(Path("/dev/shm").glob(f"bundle-{os.getpid()}-*"))


needs_memory_folder = pytest.mark.skipif(
    not os.access("/dev/shm", os.W_OK), reason="no folder in memory"
)


@needs_memory_folder
@pytest.mark.parametrize("images_per_file", [1, 3, 64])
def test_files_have_the_observations_of_the_objects(monkeypatch, files_read, images_per_file):
    monkeypatch.setattr(module, "_IMAGES_PER_FILE", images_per_file)
    model = rigs(1)
    images = images_of(model)
    points = [model.point3D(key) for key in sorted(model.points3D, reverse=True)]
    points[3].track = pycolmap.Track()
    points[4].track.add_element(2**32 - 2, 2**32 - 2)
    images[2].points2D[0].point3D_id = 2**64 - 2  # any id but that of no point
    images[1].points2D[3].xy[:] = 1e-300, -0.1
    check(images, points)
    assert sum(files_read) == len(images)
    assert max(files_read) == min(images_per_file, len(images))
    monkeypatch.delattr(pycolmap.Track, "elements")
    assert len(observations_and_tracks([], points)[1]) == sum(p.track.length() for p in points)


@needs_memory_folder
def test_images_without_observations_and_no_images_have_none(files_read):
    model = rigs(0)
    image = images_of(model)[0]
    for index in image.get_observation_point2D_idxs():
        model.delete_observation(image.image_id, index)
    assert len(Observations.of([image]).keypoints()) == len(Observations.of([image]).xy) == 0
    assert len(Observations.of([]).xy) == 0
    assert files_read == [1, 1, 0]


def _cut(content):
    return content[:-8]


def _other_version(content):
    return content[:8] + bytes(8) + content[8:-8]


def _second_of_the_same_id(content):
    return content[:8] + content[-59:-51] + content[16:]  # the last track has one element


FAULTS = {
    "no folder": (None, None),
    "not written": (None, None),
    "images cut": ("images.bin", _cut),
    "tracks cut": ("points3D.bin", _cut),
    "other images": ("images.bin", _other_version),
    "other tracks": ("points3D.bin", _other_version),
    "a point twice": ("points3D.bin", _second_of_the_same_id),
}


@needs_memory_folder
@pytest.mark.parametrize("fault", FAULTS)
def test_objects_are_read_where_a_file_cannot(monkeypatch, files_read, fault):
    def refuse(*_):
        raise PermissionError("read-only")

    def fail(*_):
        raise ValueError("Could not open images.bin")  # as pycolmap

    model = rigs(1)
    images, points = images_of(model), [point for _, point in sorted(model.points3D.items())]
    if fault == "a point twice":
        for row, point in enumerate(points):
            point.track = pycolmap.Track([pycolmap.TrackElement(7, row)])
    name, change = FAULTS[fault]
    if fault == "no folder":
        monkeypatch.setattr(module.Path, "mkdir", refuse)
    elif fault == "not written":
        monkeypatch.setattr(module.pycolmap.Reconstruction, "write_binary", fail)
    else:
        read = module.Path.read_bytes
        monkeypatch.setattr(
            module.Path,
            "read_bytes",
            lambda path: change(read(path)) if path.name == name else read(path),
        )
    check(images, points)
    assert files_read == [len(images) if name == "points3D.bin" else 0]


def named_part(model, rng, min_track_length, num_points=20):
    """Return what is read for most images and some points, which other images see, too."""
    config = pycolmap.BundleAdjustmentConfig()
    images = sorted(model.reg_image_ids())
    for image_id in rng.permutation(images)[: len(images) * 2 // 3].tolist():
        config.add_image(image_id)
    for row, point_id in enumerate(rng.permutation(sorted(model.points3D))[:num_points].tolist()):
        (config.add_variable_point if row % 3 else config.add_constant_point)(point_id)
    content = adjustment_objects.config_of(model, config)
    return adjustment_objects.adjusted_fields(model, content, min_track_length)


@needs_memory_folder
@pytest.mark.parametrize(
    ("made", "shortest", "num_points"),
    [
        *((rigs, 0, 20), (rigs, 4, 20), (rigs, 0, 0)),
        *((images_alone, 0, 20), (images_alone, 0, 0), (images_alone, 4, 0)),
    ],
)
def test_files_of_a_small_model_have_what_its_objects_have(monkeypatch, made, shortest, num_points):
    model, found = made(shortest), []

    def counted(*arguments):
        found.append(small_model(*arguments))
        return found[-1]

    model.deregister_frame(sorted(model.reg_frame_ids())[1])
    model.image(sorted(model.reg_image_ids())[0]).name = "a longer name.jpg"
    monkeypatch.setattr(adjustment_objects, "small_model", counted)
    by_file = named_part(model, np.random.default_rng(3), shortest, num_points)
    monkeypatch.setattr(adjustment_objects, "small_model", lambda *_: None)
    by_object = named_part(model, np.random.default_rng(3), shortest, num_points)
    assert found[0] is not None
    assert (by_file.tracks == by_object.tracks).all()
    assert (by_file.frames == by_object.frames).all()
    for name, value in by_object.fields.items():
        assert np.array_equal(by_file.fields[name], value), name
        assert np.asarray(by_file.fields[name]).dtype == np.asarray(value).dtype, name


def _exchanged(model):
    first, second = (model.point3D(key).track.elements[0] for key in sorted(model.points3D)[:2])
    model.image(first.image_id).points2D[first.point2D_idx].point3D_id = sorted(model.points3D)[1]
    model.image(second.image_id).points2D[second.point2D_idx].point3D_id = sorted(model.points3D)[0]


def _many_keypoints(model):
    image = pycolmap.Image("more", np.zeros((2000, 2)), sorted(model.cameras)[0], 99)
    model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())


def _tracks_cut(folder):
    path = module.Path(folder, "points3D.bin")
    path.write_bytes(_cut(path.read_bytes()))
    return module._core.read_colmap_model(folder)


def _an_image_less(folder):
    model = images_alone(2)
    model.deregister_frame(sorted(model.reg_frame_ids())[0])
    model.write_binary(folder)
    return module._core.read_colmap_model(folder)


@needs_memory_folder
@pytest.mark.parametrize(
    "change", [_exchanged, _many_keypoints, _tracks_cut, _an_image_less, "few images"]
)
def test_objects_are_read_of_large_models_and_of_those_with_errors(monkeypatch, change):
    model = images_alone(2)
    named = frozenset(sorted(model.reg_image_ids())[: 2 if change == "few images" else 4])
    if change in (_tracks_cut, _an_image_less):  # as by another thread
        write = module._written
        monkeypatch.setattr(module, "_written", lambda made, _: write(made, change))
    elif callable(change):
        assert small_model(model, named, 3) is not None
        change(model)
    assert small_model(model, named, 3) is None
