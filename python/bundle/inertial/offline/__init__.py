"""Adjustment of a reconstruction of a video together with the samples of its IMU."""
