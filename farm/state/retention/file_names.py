"""Names of the stored files in the books: models, parts, G-code, pictures, reports, stills. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm.model import Job
from farm.state.books import Books, replace_fields


def list_referenced_files(books: Books) -> frozenset[str]:
    """List the files to which the books refer, and which must exist; of pruned jobs, only the pictures."""
    return frozenset().union(*group_file_names_by_job(books).values())


def list_deletable_files(books: Books) -> frozenset[str]:
    """List the files of pruned jobs that may be deleted, because no other job needs them."""
    unpruned_books = Books.from_entities(
        [
            *(replace_fields(job, pruned_s=None) for job in books.jobs.values() if job.pruned_s is not None),
            *books.parts.values(),
            *books.plates.values(),
            *books.prints.values(),
        ]
    )
    return list_referenced_files(unpruned_books) - list_referenced_files(books)


def list_job_file_names(books: Books, job: Job) -> frozenset[str]:
    """List the files of a job, including those of replaced parts and plates."""
    return group_file_names_by_job(books)[job.id]


def group_file_names_by_job(books: Books) -> Mapping[int, frozenset[str]]:
    """Return the files of each job, by job id; several jobs may share a file."""
    names = {job.id: _list_own_names(job) for job in books.jobs.values()}
    kept_jobs = {job_id for job_id, job in books.jobs.items() if job.pruned_s is None}
    for part in books.parts.values():
        if part.job in kept_jobs:
            names[part.job].add(part.file)
    for plate in books.plates.values():
        if plate.job in kept_jobs:
            names[plate.job].add(plate.gcode)
    for attempt in books.prints.values():
        if attempt.job in kept_jobs:
            names[attempt.job].update(still.file for still in attempt.stills)
    return {job_id: frozenset(job_names) for job_id, job_names in names.items()}


def _list_own_names(job: Job) -> set[str]:
    """List the files in the record of a job, without those of its parts, plates and prints."""
    pictures = {*job.part_pictures.values(), *([job.picture] if job.picture else [])}
    if job.pruned_s is not None:
        return pictures
    file_names = (job.model_file, job.assembly, job.decomposition, job.instructions)
    job_files = (*file_names, *job.cuts.values(), *job.cut_instructions.values())
    return pictures | {name for name in job_files if name}
