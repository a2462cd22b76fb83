"""Files of a job, for programs and people on other hosts."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, View


class FileView(View):
    """File of a job."""

    name: str
    size: int
    sha256: str


class JobFiles(View):
    """Files of a job; a pruned job has only its pictures."""

    model_config = ConfigDict(populate_by_name=True)

    schema_: int = Field(default=SCHEMA, alias="schema")
    job: int
    files: list[FileView]
