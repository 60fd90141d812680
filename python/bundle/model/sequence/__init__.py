"""A visual-inertial sequence: images, IMU samples, calibration."""
