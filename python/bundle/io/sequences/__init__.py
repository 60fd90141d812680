"""Readers and writers of visual-inertial sequences, trajectories and tracks."""
