"""Lenses across camera models: exact conversions, fits, and rays of pixels."""
