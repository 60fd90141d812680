"""Pages that explain an inspection or a comparison: one HTML file each, nothing else needed."""

from bundle.html.comparison_page import write_comparison
from bundle.html.inspection_page import write_inspection

__all__ = ["write_comparison", "write_inspection"]
