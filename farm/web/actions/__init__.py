"""Forms of the pages: commands, each answered by a redirect to its page, which shows a note."""

from __future__ import annotations

from farm.web.actions.form_route import FormRoute, answer_form, read_form
from farm.web.actions.job_forms import job_forms
from farm.web.actions.printer_forms import printer_forms

__all__ = ["FormRoute", "answer_form", "job_forms", "printer_forms", "read_form"]
