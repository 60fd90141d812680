"""Ids, rigs and frames of the images that a merge adds."""

from types import SimpleNamespace

import numpy as np

from bundle.editing.joining import AddedImages, added_images
from bundle.model.colmap.source_records import CAMERA, Sensor

NONE = np.empty(0, np.int64)


def rigs_and_frames(rigs, frames, images, cameras):
    """Add images with these ids and cameras to a model; return ids of cameras and rigs."""
    added = AddedImages(
        shared=NONE.reshape(0, 2),
        added=np.arange(len(images)),
        image_ids=np.array(images),
        image_camera_ids=np.array(cameras),
        camera_rows=NONE,
        camera_ids=NONE,
        place_of_b=np.arange(len(images)),
    )
    a = SimpleNamespace(
        rigs=[(rig, [Sensor(CAMERA, camera) for camera in sensors]) for rig, sensors in rigs],
        frames=[(frame, 1, None, ()) for frame in frames],
    )
    b = SimpleNamespace(cam_from_world=np.zeros((len(images), 7)))
    found, placed = added._rigs_and_frames(a, b)
    return (
        {rig: [sensor.id for sensor in sensors] for rig, sensors in found.items()},
        {frame: row[1] for frame, row in placed.items() if frame not in frames},
    )


def test_the_smallest_rig_of_a_camera_alone_is_used():
    rigs = [(1, [9, 4]), (5, [4]), (3, [4])]
    found, frames = rigs_and_frames(rigs, [], [7], [4])
    assert found == dict(rigs)
    assert frames == {7: 3}


def test_a_new_rig_has_the_id_of_its_camera_if_that_is_free():
    rigs = [(3, [9, 4]), (5, [9])]
    found, frames = rigs_and_frames(rigs, [], [7, 8], [2, 3])
    assert found == {**dict(rigs), 2: [2], 6: [3]}
    assert frames == {7: 2, 8: 6}


def test_new_frames_never_replace_others():
    found, frames = rigs_and_frames([(1, [1])], [8], [8, 9], [1, 1])
    assert found == {1: [1]}
    assert frames == {9: 1, 10: 1}


def records(images, cameras, image_cameras):
    """Ids of the images and cameras of a model, and the camera of each image."""
    return SimpleNamespace(
        image_ids=np.array(images),
        camera_ids=np.array(cameras),
        image_camera_ids=np.array(image_cameras),
    )


def test_new_ids_are_above_all_ids_of_both_models():
    a, b = records([1, 2, 3], [1], [1, 1, 1]), records([3, 2, 4], [1, 2], [1, 1, 2])
    found = added_images(a, b, np.array([[0, 0]]), {})
    assert found.added.tolist() == [1, 2]
    assert found.image_ids.tolist() == [5, 4]  # 4 is taken by the other image of B
    assert found.camera_ids.tolist() == [3, 2]
    assert found.image_camera_ids.tolist() == [3, 2]
    assert found.place_of_b.tolist() == [0, 3, 4]
