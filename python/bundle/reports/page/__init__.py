"""HTML pages about reconstructions, graphs, inspections, comparisons and odometries, one file each.

A browser shows a page without any other file and without network access.
"""

from bundle.reports.page.check_page import write_check
from bundle.reports.page.comparison_page import write_comparison
from bundle.reports.page.evaluation_page import write_evaluation
from bundle.reports.page.inspection_page import write_inspection
from bundle.reports.page.odometry_page import write_odometry
from bundle.reports.page.report_by_input import report
from bundle.reports.page.report_page import write_report

__all__ = [
    "report",
    "write_check",
    "write_comparison",
    "write_evaluation",
    "write_inspection",
    "write_odometry",
    "write_report",
]
