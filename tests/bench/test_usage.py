"""Usage text of each bench, which must name exactly the options that its parser accepts."""

import ast
import re
from pathlib import Path

import pytest

BENCH = Path(__file__).parents[2] / "bench"
CLUSTER_OPTIONS = {"--scheduler", "--certificates"}  # added by `add_cluster_options`
OPTION_PATTERN = r"(?<![\w-])--[a-z][a-z-]*"


def list_benches() -> list[Path]:
    return [path for path in sorted(BENCH.rglob("*.py")) if "[--json]" in read_docstring(path)]


def read_docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text())) or ""


@pytest.mark.parametrize("path", list_benches(), ids=lambda path: str(path.relative_to(BENCH)))
def test_usage_names_the_options_of_the_parser(path: Path):
    text = path.read_text()
    parser_options = set(re.findall(rf'add_argument\(\s*"({OPTION_PATTERN})"', text))
    if "add_cluster_options(" in text:
        parser_options |= CLUSTER_OPTIONS
    named_options = set(re.findall(OPTION_PATTERN, re.sub(r"`farm [^`]*`", "", read_docstring(path))))
    assert named_options == parser_options


def test_most_benches_have_a_usage():
    assert len(list_benches()) > 35
