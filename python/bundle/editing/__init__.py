"""Edits of models before a solve: camera models, shared cameras, rigs, merging."""
