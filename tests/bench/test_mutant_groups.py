"""Groups of mutation testing, whose modules and tests must exist."""

from pathlib import Path

import pytest

from bench.mutant_groups import GROUPS

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", GROUPS)
def test_modules_and_tests_of_a_group_exist(name: str):
    group = GROUPS[name]
    assert [path for path in (*group.modules, *group.tests) if not (ROOT / path).exists()] == []
