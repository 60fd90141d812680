"""Findings: facts about a model that its user should act on, each with its test."""
