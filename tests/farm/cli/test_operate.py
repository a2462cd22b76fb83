"""What a person writes for a job, a part or a printer."""

import pytest

from farm.cli.operate import place_of


@pytest.mark.parametrize(
    ("target", "path"),
    [
        ("3", "/jobs/3"),
        ("3/p01", "/jobs/3/parts/p01"),
        ("3/1", "/jobs/3/parts/1"),
        ("um2-03", "/printers/um2-03"),
    ],
)
def test_a_target_is_a_job_a_part_or_a_printer(target, path):
    assert place_of(target) == path
