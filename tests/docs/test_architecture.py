"""Check that ARCHITECTURE.md lists every folder, and that the names in it exist."""

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
PACKAGES = ("farm", "drivers", "decompose", "slicing")
MAX_CELL_WORDS = 30


def list_rows(title: str) -> list[list[str]]:
    """List the cells of the table under a heading, without its first two lines."""
    section = TEXT.split(f"## {title}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_every_folder_has_a_row() -> None:
    folders = {
        str(init.parent.relative_to(ROOT))
        for package in PACKAGES
        for init in (ROOT / package).rglob("__init__.py")
    }
    folder_names = [cells[0].strip("`") for cells in list_rows("Folders")]
    assert sorted(folder_names) == sorted(folders)


def test_no_cell_is_longer_than_thirty_words() -> None:
    cells = [cell for line in TEXT.splitlines() if line.startswith("|") for cell in line.split("|")]
    assert [cell for cell in cells if len(cell.split()) > MAX_CELL_WORDS] == []


def test_every_word_of_the_glossary_is_in_the_code() -> None:
    for term, _, name in list_rows("Words"):
        module, _, member = name.strip("`").rpartition(".")
        if member[0].isupper():
            assert hasattr(importlib.import_module(module), member), term
        else:
            importlib.import_module(name.strip("`"))


def test_every_path_and_name_in_the_journey_exists() -> None:
    journey = TEXT.split("## One job's journey\n")[1].split("\n## ")[0]
    paths = [name for name in re.findall(r"`([\w/]+)`", journey) if name.partition("/")[0] in PACKAGES]
    assert paths
    for name in paths:
        assert (ROOT / name).is_dir() or (ROOT / f"{name}.py").is_file(), name
