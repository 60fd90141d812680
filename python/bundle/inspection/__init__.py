"""What solving costs, before any arithmetic."""

from __future__ import annotations

from bundle.inspection.inspect import Inspection, MethodInspection, inspect

__all__ = ["Inspection", "MethodInspection", "inspect"]
