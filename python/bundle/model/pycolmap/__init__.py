"""Conversion between problems and pycolmap reconstructions."""
