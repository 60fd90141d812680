"""Tracks of features through the images of a recording."""
