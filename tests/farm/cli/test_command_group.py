"""Imports of commands when they are used: tests list loaded modules, because times depend on the host."""

import inspect
import json
import os
import subprocess
import sys

import pytest

from farm.cli.command_group import load_commands
from farm.cli.main import COMMANDS, app

ENTRIES = {entry.name: entry for entries in COMMANDS.values() for entry in entries}
SCRIPT = """
import atexit, json, sys
from farm.cli.main import main
sys.argv = ["farm", *{words}]
atexit.register(lambda: print(json.dumps(sorted(sys.modules)), file=sys.stderr))
main()
"""


def list_loaded_modules(*arguments, **environment):
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(words=list(arguments))],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    return set(json.loads(result.stderr.splitlines()[-1]))


def list_commands(modules):
    return {name.rpartition(".")[2] for name in modules if name.startswith("farm.cli.commands.")}


@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("sumbit",)])
def test_help_and_unknown_command_load_no_command(arguments):
    modules = list_loaded_modules(*arguments)
    assert list_commands(modules) == set()
    assert not modules & {"yaml", "serial", "farm.api", "farm.model"}


def test_no_command_is_loaded_to_complete_its_name():
    completion_variables = {"_FARM_COMPLETE": "complete_bash", "COMP_WORDS": "farm st", "COMP_CWORD": "1"}
    modules = list_loaded_modules(**completion_variables)
    assert list_commands(modules) == set() and "farm.api" not in modules


@pytest.mark.parametrize(
    ("command", "module", "unused_modules"),
    [
        ("status", "status", {"yaml", "serial", "drivers.records", "drivers.safety", "farm.fleet_file"}),
        ("submit", "submit", {"yaml", "serial", "drivers.records", "drivers.safety", "farm.fleet_file"}),
        ("estop", "estop", {"serial", "drivers.records", "drivers.safety", "farm.api", "farm.cli.display"}),
    ],
)
def test_command_loads_only_its_own_module(command, module, unused_modules):
    modules = list_loaded_modules(command, "--help")
    assert list_commands(modules) == {module}
    assert not modules & unused_modules


@pytest.mark.parametrize("name", ENTRIES)
def test_list_of_commands_has_the_help_of_each_command(name):
    command = load_commands(app)[name]
    assert command.name == name
    assert inspect.cleandoc(command.help).split("\n\n")[0].replace("\n", " ") == ENTRIES[name].help
