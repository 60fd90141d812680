"""Keypoints that two images of one name share."""

import numpy as np
import pycolmap
import pytest

import bundle
from bundle.editing.joining import shared_keypoints
from bundle.model.colmap.model_records import model_records


def records(xy, seen):
    """One image whose seen keypoints have points of their own."""
    made = pycolmap.Reconstruction()
    made.add_camera_with_trivial_rig(
        pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.PINHOLE, 100.0, 80, 60)
    )
    image = pycolmap.Image("x.jpg", np.array(xy, float), 1, 1)
    made.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for keypoint in seen:
        track = pycolmap.Track([pycolmap.TrackElement(1, keypoint)])
        made.add_point3D_with_id(keypoint + 100, pycolmap.Point3D(xyz=[0, 0, 1], track=track))
    problem = bundle.Problem.from_pycolmap(made)
    return model_records(problem, vars(problem)["source"])


A = [[1, 1], [2, 2], [3, 3], [3, 3], [4, 4]]
SEEN = [0, 4]


@pytest.mark.parametrize(
    "xy, same",
    [
        (A, [0, 1, 2, 3, 4]),  # equal pixels are told apart by the index
        ([[1.005, 1], [2.02, 2]], [0, -1]),  # single precision is one, a shift is not
        ([[4, 4], [2, 2]], [4, 1]),  # a list that was cut down
        ([[4, 4], [1, 1]], [4, 0]),  # the first keypoint, at another place
        ([[3, 3]], [-1]),  # two keypoints that it may be
        ([[4, 4], [4, 4]], [4, -1]),  # one keypoint cannot be two
        ([[1, 1], [1, 1]], [0, -1]),  # nor if the first is the same by its index
    ],
)
def test_keypoints_are_the_same_by_index_or_by_pixels(xy, same):
    a, b = records(A, SEEN), records(xy, range(len(xy)))
    found = shared_keypoints(a, b, np.array([[0, 0]]))
    assert found.row_a.tolist() == same
    assert found.row_b.tolist() == list(range(len(xy)))
    rows = [(SEEN.index(other), keypoint) for keypoint, other in enumerate(same) if other in SEEN]
    assert found.meetings_by_image(a, b).tolist() == [[0, *row] for row in rows]
    met = found.meetings(a, b)
    assert list(zip(met.point_a, met.point_b, met.count, strict=True)) == [(*r, 1) for r in rows]
