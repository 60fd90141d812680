"""Pages on a reconstruction, an inspection, a comparison or an odometry: one HTML file each.

Nothing else is needed to read them, no network either.
"""

from bundle.html.comparison_page import write_comparison
from bundle.html.inspection_page import write_inspection
from bundle.html.odometry_page import write_odometry
from bundle.html.report_page import write_report

report = write_report
"""The name of :func:`write_report` directly in ``bundle``."""

__all__ = ["report", "write_comparison", "write_inspection", "write_odometry", "write_report"]
