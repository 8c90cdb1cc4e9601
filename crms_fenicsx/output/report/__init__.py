"""The report of a run: one page of HTML, and tables beside it."""

from crms_fenicsx.output.report.reporting import Reporting

__all__ = ["Reporting"]
