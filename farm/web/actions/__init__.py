"""Routes of the forms on pages. Each form sends a command; the response redirects to the form's page.

The page then shows a note on the result.
"""

from __future__ import annotations

from farm.web.actions.form_route import FormRoute, answer_form, read_form
from farm.web.actions.job_forms import make_job_form_routes, make_part_form_routes
from farm.web.actions.printer_forms import make_print_form_routes, make_printer_form_routes

__all__ = [
    "FormRoute",
    "answer_form",
    "make_job_form_routes",
    "make_part_form_routes",
    "make_print_form_routes",
    "make_printer_form_routes",
    "read_form",
]
