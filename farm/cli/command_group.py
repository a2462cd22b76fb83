"""Group of commands that imports the module of a command when the command is used.

This makes help, completion and every command start faster: importing a module takes up to 0.3 s of CPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import typer.main
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True, slots=True)
class CommandEntry:
    """Entry of a command in the table of commands (`farm.cli.main.COMMANDS`).

    Attributes
    ----------
    name
        Its name on the command line.
    function
        The function that runs the command, as `module.function` in `farm.cli.commands`.
    help
        Its line in the list of commands: the first paragraph of the function's docstring.
    """

    name: str
    function: str
    help: str


class LazyCommand(TyperCommand):
    """Placeholder of a command in the help and in the completion; `load` imports the command itself."""

    def __init__(self, entry: CommandEntry, panel: str) -> None:
        super().__init__(entry.name, help=entry.help, rich_help_panel=panel)
        self._entry = entry

    def load(self) -> Any:
        """Import the module of the command, and build the command with its options.

        Returns
        -------
        click command
            The command; the annotation is `Any`, because typer does not export the type.
        """
        module, function_name = self._entry.function.split(".")
        function: Callable[..., None] = getattr(import_module(f"farm.cli.commands.{module}"), function_name)
        single_command_app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        single_command_app.command(self._entry.name, rich_help_panel=self.rich_help_panel)(function)
        return typer.main.get_command(single_command_app)


def make_group(panels: Mapping[str, Iterable[CommandEntry]]) -> type[TyperGroup]:
    """Make a subclass of TyperGroup with the given commands, for `typer.Typer(cls=...)`.

    Parameters
    ----------
    panels
        The commands, in the order of the help, by the heading under which the help lists them.
    """

    class Group(TyperGroup):
        def __init__(self, **settings: Any) -> None:
            super().__init__(**settings)
            for panel, entries in panels.items():
                for entry in entries:
                    self.add_command(LazyCommand(entry, panel))

        def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
            name, command, rest = super().resolve_command(ctx, args)
            return name, command.load() if isinstance(command, LazyCommand) else command, rest

    return Group


def load_commands(app: typer.Typer) -> dict[str, Any]:
    """Import all commands of an app, from which its documentation is generated; return them by name."""
    group: Any = typer.main.get_command(app)
    return {name: command.load() for name, command in group.commands.items()}
