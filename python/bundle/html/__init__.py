"""Pages that explain an inspection or a comparison: one HTML file each, nothing else needed."""

from bundle.html.comparison import write_comparison

__all__ = ["write_comparison"]
