"""Status and bed of the emulator of a ``sim://`` port; a real printer reports neither."""

from __future__ import annotations

from pathlib import Path

from drivers.emulator.launch import control, read_status
from drivers.emulator.status import EmulatorStatus
from drivers.errors import PortError


class EmulatorBed:
    """The emulator behind a port, if there is one.

    Parameters
    ----------
    folder
        Folder of the emulator; None for a real printer.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def status(self) -> EmulatorStatus | None:
        """Read the status of the emulator; None for a real printer, or if it does not answer."""
        if self._folder is None:
            return None
        try:
            return read_status(self._folder)
        except PortError:
            return None

    def clear(self) -> None:
        """Clear the bed of the emulator.

        Raises
        ------
        PortError
            The emulator does not answer.
        """
        if self._folder is not None:
            control(self._folder, "clear_bed")
