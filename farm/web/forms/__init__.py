"""Readers of the forms that browsers and slicers send: their fields, and uploads of models."""

from __future__ import annotations

from farm.web.forms.fields import read_fields
from farm.web.forms.multipart import BadForm, FormReader
from farm.web.forms.upload import FormUploads

__all__ = ["BadForm", "FormReader", "FormUploads", "read_fields"]
