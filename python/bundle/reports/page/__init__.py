"""HTML pages about reconstructions, graphs, inspections, comparisons and odometries, one file each.

A browser shows a page without any other file and without network access.
"""

from bundle.reports.page.inspection_page import write_inspection
from bundle.reports.page.report_page import report, write_report
from bundle.reports.page.result_pages import (
    write_check,
    write_comparison,
    write_evaluation,
    write_odometry,
)

__all__ = [
    "report",
    "write_check",
    "write_comparison",
    "write_evaluation",
    "write_inspection",
    "write_odometry",
    "write_report",
]
