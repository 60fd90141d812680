"""Determined and undetermined parameters, uncertainty, statistics."""
