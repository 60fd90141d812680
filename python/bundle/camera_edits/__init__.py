"""Cameras of a problem with another model, shared by images, or one for each."""

from bundle.camera_edits.camera_sharing import share_cameras, split_cameras
from bundle.camera_edits.edit_record import CameraEdits, edit_cameras
from bundle.camera_edits.model_change import (
    CameraModelChange,
    ChangedModels,
    change_camera_model,
)

__all__ = [
    "CameraEdits",
    "CameraModelChange",
    "ChangedModels",
    "change_camera_model",
    "edit_cameras",
    "share_cameras",
    "split_cameras",
]
