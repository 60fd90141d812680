"""Predicted structure, memory and time of a solve (bundle inspect)."""
