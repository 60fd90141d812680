"""Preintegration of IMU samples between two states, as one factor."""
