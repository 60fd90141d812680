"""IMU, sliding windows, odometry, two loops."""
