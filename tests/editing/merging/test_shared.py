"""Keypoints that two images of one name share."""

import numpy as np
import pycolmap
import pytest

from bundle.model.pycolmap.shared_keypoints import shared_keypoints


def model(xy, seen):
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
    return made


A = [[1, 1], [2, 2], [3, 3], [3, 3], [4, 4]]


@pytest.mark.parametrize(
    "xy, same",
    [
        (A, {0: 0, 1: 1, 2: 2, 3: 3, 4: 4}),  # equal pixels are told apart by the index
        ([[1.005, 1], [2.02, 2]], {0: 0, 1: None}),  # single precision is one, a shift is not
        ([[4, 4], [2, 2]], {0: 4, 1: 1}),  # a list that was cut down
        ([[4, 4], [1, 1]], {0: 4, 1: 0}),  # the first keypoint, at another place
        ([[3, 3]], {0: None}),  # two keypoints that it may be
        ([[4, 4], [4, 4]], {0: 4, 1: None}),  # one keypoint cannot be two
    ],
)
def test_keypoints_are_the_same_by_index_or_by_pixels(xy, same):
    found = shared_keypoints(model(A, [0, 4]), model(xy, range(len(xy))), [(1, 1)])
    assert found.keypoints == (same,)
    rows = [(0, other + 100, keypoint + 100) for keypoint, other in same.items() if other in (0, 4)]
    met = zip(found.image.tolist(), found.point_a.tolist(), found.point_b.tolist(), strict=True)
    assert list(met) == rows
