"""Seeded flights: images, tracks and IMU samples."""
