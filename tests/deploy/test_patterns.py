"""Search of all sources for regular expressions that Python 3.11.2 of Debian 12 matches wrongly."""

import ast
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("farm", "drivers", "decompose", "slicing", "bench", "examples", "docs", "tests")
POSSESSIVE_SYNTAX = re.compile(r"\(\?>|[*+?}]\+")  # an atomic group, a possessive quantifier
HARMLESS_LITERALS = {"k-means++"}


def list_literals(tree: ast.AST) -> Iterator[str]:
    """Yield the strings and bytes of a module except for docstrings."""
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and id(node) not in docstrings
            and isinstance(node.value, str | bytes)
        ):
            yield node.value if isinstance(node.value, str) else node.value.decode("latin-1")


def has_broken_syntax(text: str) -> bool:
    """Return True if a literal, read as a pattern, uses syntax that is broken in Python 3.11.2."""
    if text in HARMLESS_LITERALS or POSSESSIVE_SYNTAX.search(text) is None:
        return False
    try:
        with warnings.catch_warnings(action="ignore"):
            pattern = repr(re._parser.parse(text).data)  # type: ignore[attr-defined]
    except re.error:
        return True  # a fragment of a pattern
    return "POSSESSIVE_REPEAT" in pattern or "ATOMIC_GROUP" in pattern


@pytest.mark.parametrize("text", ["a++", "(a*+b)?", "[0-9]{2}+", "(?>a|ab)c", "(x?+"])
def test_check_finds_every_broken_pattern(text: str) -> None:
    assert has_broken_syntax(text)


@pytest.mark.parametrize("text", ["a+", r"a+\+", "[*+]+", "a+?", "k-means++"])
def test_check_accepts_valid_patterns(text: str) -> None:
    assert not has_broken_syntax(text)


def test_no_source_has_a_possessive_quantifier_or_an_atomic_group() -> None:
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if path != Path(__file__)]
    assert len(files) > 100
    results = [
        f"{path.relative_to(ROOT)}: {text!r}"
        for path in files
        for text in list_literals(ast.parse(path.read_text()))
        if has_broken_syntax(text)
    ]
    assert not results, "these patterns match wrongly before Python 3.11.5: " + "; ".join(results)
