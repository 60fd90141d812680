"""Checked arguments, wording, tables, paths: what every room may use."""
