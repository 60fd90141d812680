"""Pages on a reconstruction, an inspection, a comparison or an odometry: one HTML file each.

Nothing else is needed to read them, no network either.
"""

from bundle.reports.page.comparison_page import write_comparison
from bundle.reports.page.inspection_page import write_inspection
from bundle.reports.page.odometry_page import write_odometry
from bundle.reports.page.report_page import write_report

report = write_report
"""The name of :func:`write_report` directly in ``bundle``."""

__all__ = ["report", "write_comparison", "write_inspection", "write_odometry", "write_report"]
