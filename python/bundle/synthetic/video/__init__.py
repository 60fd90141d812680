"""Scenes filmed by a moving camera: smooth motions, and images of a rolling shutter."""
