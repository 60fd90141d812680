"""Folders of visual-inertial sequences, trajectories, tracks."""
