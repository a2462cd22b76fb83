"""Report of a job as one HTML page."""

from __future__ import annotations

from farm.views.report.figures import list_figures
from farm.views.report.page import JobContents, load_templates, render_page

__all__ = ["JobContents", "list_figures", "load_templates", "render_page"]
