"""Rules about cameras, images and points: fixed, prior, bounds, share, ratio."""
