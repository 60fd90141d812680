"""Merge of two models into one."""
