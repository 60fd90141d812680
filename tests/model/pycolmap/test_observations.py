"""Observations of images: from a file that pycolmap writes, or from its objects."""

import os
from pathlib import Path

import numpy as np
import pytest

from bundle.model.pycolmap import reconstruction as module
from bundle.model.pycolmap.reconstruction import Observations
from tests.solving.colmap_adjustment.option_space import rigs

COLUMNS = ("image", "keypoint", "point_id", "xy")


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


def check(images):
    found = Observations.of(images)
    for name, expected in zip(COLUMNS, from_objects(images), strict=True):
        assert (getattr(found, name) == expected).all(), name


@pytest.fixture
def files_read(monkeypatch):
    """Lengths of the files that are read, and nothing left of them afterwards."""
    read, found = module._records_from_file, []

    def counted(keypoints):
        records = read(keypoints)
        found.append(len(records))
        return records

    monkeypatch.setattr(module, "_records_from_file", counted)
    yield found
    assert not list(Path("/dev/shm").glob(f"bundle-{os.getpid()}-*"))


needs_memory_folder = pytest.mark.skipif(
    not os.access("/dev/shm", os.W_OK), reason="no folder in memory"
)


@needs_memory_folder
@pytest.mark.parametrize("images_per_file", [1, 3, 64])
def test_files_have_the_observations_of_the_objects(monkeypatch, files_read, images_per_file):
    monkeypatch.setattr(module, "_IMAGES_PER_FILE", images_per_file)
    images = images_of(rigs(1))
    images[2].points2D[0].point3D_id = 2**64 - 2  # any id but that of no point
    images[1].points2D[3].xy[:] = 1e-300, -0.1
    check(images)
    assert sum(files_read) == len(images)
    assert max(files_read) == min(images_per_file, len(images))


@needs_memory_folder
def test_images_without_observations_and_no_images_have_none(files_read):
    model = rigs(0)
    image = images_of(model)[0]
    for index in image.get_observation_point2D_idxs():
        model.delete_observation(image.image_id, index)
    assert len(Observations.of([image]).xy) == 0
    assert len(Observations.of([]).xy) == 0
    assert files_read == [1]


@needs_memory_folder
@pytest.mark.parametrize("fault", ["no folder", "not written", "cut", "other version"])
def test_objects_are_read_where_a_file_cannot(monkeypatch, files_read, fault):
    def refuse(*_):
        raise PermissionError("read-only")

    def fail(*_):
        raise ValueError("Could not open images.bin")  # as pycolmap

    def cut(content):
        return content[:-8]

    def other_version(content):
        return content[:8] + bytes(8) + content[8:-8]

    images = images_of(rigs(1))
    if fault == "no folder":
        monkeypatch.setattr(module.Path, "mkdir", refuse)
    elif fault == "not written":
        monkeypatch.setattr(module.pycolmap.Reconstruction, "write_binary", fail)
    else:
        change = cut if fault == "cut" else other_version
        read = module.Path.read_bytes
        monkeypatch.setattr(module.Path, "read_bytes", lambda path: change(read(path)))
    check(images)
    assert files_read == [0]
