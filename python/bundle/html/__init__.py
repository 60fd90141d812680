"""Pages that explain an inspection or a comparison: one HTML file each, nothing else needed."""

from bundle.html.comparison import write_comparison
from bundle.html.inspection import write_inspection

__all__ = ["write_comparison", "write_inspection"]
