"""Images of model B that model A lacks, with their cameras, and the rigs and frames that they need.

An image of B keeps its id if A does not use it, and so does a camera; others get ids above all ids
of both models. Every added image has a frame of its own. Its camera has a rig of its own: the rig
with the smallest id of which it is the only camera, or a new rig.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.colmap.model_records import ModelRecords
from bundle.model.colmap.source_records import CAMERA, Sensor, frame_of_image, is_trivial

_Indices = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class AddedImages:
    """Shared images of A and B, and those that B adds. Positions are those in the records.

    Attributes:
        shared: (n, 2) positions in A and in B of each shared image.
        added: (num_added,) positions in B, by id; they follow A's images.
        image_ids: (num_added,) new ids.
        image_camera_ids: (num_added,) ids of their cameras in the merged model.
        camera_rows: rows in B of the added cameras.
        camera_ids: new ids of the added cameras.
        place_of_b: (num_images of B,) position of each image of B in the merged model.
    """

    shared: _Indices
    added: _Indices
    image_ids: _Indices
    image_camera_ids: _Indices
    camera_rows: _Indices
    camera_ids: _Indices
    place_of_b: _Indices

    def with_images(self, a: ModelRecords, b: ModelRecords) -> ModelRecords:
        """Return the records of A with the images of B; keypoints are those of A."""
        cameras = np.append(a.camera_ids, self.camera_ids)
        by_id = np.argsort(cameras)
        models = [*a.camera_models, *(b.camera_models[row] for row in self.camera_rows)]
        rigs, frames = self._rigs_and_frames(a, b)
        return dataclasses.replace(
            a,
            camera_ids=cameras[by_id],
            camera_models=tuple(models[row] for row in by_id),
            camera_sizes=np.concatenate([a.camera_sizes, b.camera_sizes[self.camera_rows]])[by_id],
            camera_params=_stacked(a.camera_params, b.camera_params[self.camera_rows])[by_id],
            rigs=sorted(rigs.items()),
            frames=[frames[frame_id] for frame_id in sorted(frames)],
            image_ids=np.append(a.image_ids, self.image_ids),
            image_names=(*a.image_names, *(b.image_names[row] for row in self.added)),
            image_camera_ids=np.append(a.image_camera_ids, self.image_camera_ids),
            cam_from_world=np.concatenate([a.cam_from_world, b.cam_from_world[self.added]]),
        )

    def _rigs_and_frames(
        self, a: ModelRecords, b: ModelRecords
    ) -> tuple[dict[int, list[Sensor]], dict[int, tuple[int, *tuple[object, ...]]]]:
        rigs = dict(a.rigs)
        frames = {int(frame[0]): frame for frame in a.frames}
        rig_of: dict[int, int] = {}
        for rig_id, sensors in sorted(rigs.items()):
            if sensors and sensors[0].type == CAMERA and is_trivial(sensors):
                rig_of.setdefault(sensors[0].id, rig_id)
        last_frame = max(frames, default=0)
        poses = b.cam_from_world[self.added].tolist()
        for image_id, camera_id, pose in zip(
            self.image_ids.tolist(), self.image_camera_ids.tolist(), poses, strict=True
        ):
            if camera_id not in rig_of:
                rig_of[camera_id] = camera_id if camera_id not in rigs else max(rigs) + 1
                rigs[rig_of[camera_id]] = [Sensor(CAMERA, camera_id)]
            frame_id = image_id if image_id not in frames else last_frame + 1
            last_frame = max(last_frame, frame_id)
            frame = frame_of_image(rig_of[camera_id], image_id, camera_id, tuple(pose))
            frames[frame_id] = (frame_id, frame.rig_id, frame.pose, frame.data)
        return rigs, frames


def added_images(
    a: ModelRecords, b: ModelRecords, shared: _Indices, cameras: dict[int, int]
) -> AddedImages:
    """Return the images that B adds to A.

    Args:
        a: records of model A.
        b: records of model B.
        shared: (n, 2) positions in A and in B of each shared image.
        cameras: table from cameras of B to cameras of A that replace them.
    """
    others = np.setdiff1d(np.arange(len(b.image_ids)), shared[:, 1])
    added = others[np.argsort(b.image_ids[others])]
    needed = list(dict.fromkeys(b.image_camera_ids[added].tolist()))
    new = np.array([camera for camera in needed if camera not in cameras], np.int64)
    new_ids = _free_ids(new, a.camera_ids, b.camera_ids)
    table = {**cameras, **dict(zip(new.tolist(), new_ids.tolist(), strict=True))}
    place = np.empty(len(b.image_ids), np.int64)
    place[shared[:, 1]] = shared[:, 0]
    place[added] = len(a.image_ids) + np.arange(len(added))
    return AddedImages(
        shared=shared,
        added=added,
        image_ids=_free_ids(b.image_ids[added], a.image_ids, b.image_ids),
        image_camera_ids=np.array(
            [table[camera] for camera in b.image_camera_ids[added].tolist()], np.int64
        ),
        camera_rows=np.searchsorted(b.camera_ids, new),
        camera_ids=new_ids,
        place_of_b=place,
    )


def _free_ids(ids: _Indices, taken: _Indices, others: _Indices) -> _Indices:
    """Return ids that are not taken; ids that are get new ones above all."""
    is_taken = np.isin(ids, taken)
    spare = max(taken.max(initial=0), others.max(initial=0))
    free = ids.copy()
    free[is_taken] = spare + 1 + np.arange(int(is_taken.sum()))
    return free


def _stacked(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows of both, padded with zeros to the larger width."""
    width = max(a.shape[1], b.shape[1])
    return np.concatenate([np.pad(rows, ((0, 0), (0, width - rows.shape[1]))) for rows in (a, b)])
