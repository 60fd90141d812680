"""Checks of arguments, wording, tables, paths: utilities that every package may use."""
