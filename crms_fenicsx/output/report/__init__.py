"""The report of a run: one page of HTML, and tables beside it."""
