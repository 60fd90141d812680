"""Covariances of poses, cameras and points."""
