"""Check that every command and option on the pages exists."""

import re
from pathlib import Path

import pytest

from farm.cli.command_group import load_commands
from farm.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    page
    for page in (ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md")))
    if not page.name.endswith(".intro.md")
]
COMMANDS = {
    name: {option for param in command.params for option in (*param.opts, *param.secondary_opts)} | {"--help"}
    for name, command in load_commands(app).items()
}
COMMAND_PATTERN = re.compile(
    r"(?:^\s*(?:\$ )?|`|\$ )farm (?!is down)([a-z][a-z-]*)((?: [^`\n]*)?)", re.MULTILINE
)


def list_mistakes(text: str) -> list[str]:
    """List the commands and options in a page that the program does not have."""
    results = []
    for name, arguments in COMMAND_PATTERN.findall(text):
        if name not in COMMANDS:
            results.append(f"farm {name}")
            continue
        options = re.findall(r"(?<![\w-])--[a-z][a-z-]*", re.split(r";|&&|#|\|", arguments)[0])
        results += [f"farm {name} {option}" for option in options if option not in COMMANDS[name]]
    return results


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_page_names_commands_and_options_that_exist(page: Path):
    assert list_mistakes(page.read_text(encoding="utf-8")) == []


def test_wrong_command_and_a_wrong_option_are_found():
    text = "Type `farm sumbit x.stl`.\n\n```text\n$ farm submit x.stl --overnite --wait\n```\n"
    assert list_mistakes(text) == ["farm sumbit", "farm submit --overnite"]


def test_readme_submits_existing_or_generated_files_only():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = [line for block in re.findall(r"```\n(.*?)```", text, re.DOTALL) for line in block.splitlines()]
    created_files = set[str]()
    submit_count = 0
    for line in lines:
        arguments = line.partition("#")[0].split()
        if arguments[:1] == ["python"]:
            assert (ROOT / arguments[1]).exists()
            created_files.update(arguments[2:])
        elif arguments[:2] == ["farm", "submit"]:
            submit_count += 1
            assert arguments[2] in created_files or (ROOT / arguments[2]).exists(), line
    assert submit_count
