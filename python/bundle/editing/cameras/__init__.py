"""Edits of cameras: change of the camera model, sharing and splitting."""
