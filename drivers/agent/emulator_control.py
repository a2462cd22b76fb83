"""Access to the emulator of a ``sim://`` port: its status, and its bed; a real printer reports neither."""

from __future__ import annotations

from pathlib import Path

from drivers.emulator import launch
from drivers.emulator.status import EmulatorStatus
from drivers.errors import PortError


class EmulatorControl:
    """Access to the emulator behind a port, if there is one.

    Parameters
    ----------
    folder
        Folder of the emulator; None for a real printer.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def read_status(self) -> EmulatorStatus | None:
        """Read the status of the emulator; None for a real printer, or if it does not answer."""
        if self._folder is None:
            return None
        try:
            return launch.read_status(self._folder)
        except PortError:
            return None

    def clear_bed(self) -> None:
        """Clear the bed of the emulator.

        Raises
        ------
        PortError
            The emulator does not answer.
        """
        if self._folder is not None:
            launch.control(self._folder, "clear_bed")
