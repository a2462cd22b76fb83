"""Forms of the pages: the commands of people, each answered by the page that it came from, with a note."""

from __future__ import annotations

from farm.web.actions.form_route import FormRoute, answer_form, read_form
from farm.web.actions.job_forms import job_forms
from farm.web.actions.printer_forms import printer_forms

__all__ = ["FormRoute", "answer_form", "job_forms", "printer_forms", "read_form"]
