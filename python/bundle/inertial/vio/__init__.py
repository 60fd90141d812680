"""Visual-inertial odometry by sliding windows."""
