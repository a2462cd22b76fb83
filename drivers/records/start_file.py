"""Start file of an agent, written into its folder by the process that starts it."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from drivers.clock import Clock
from drivers.errors import AgentError

START_FILE = "start.json"  # file in an agent's folder
AGENT_LOG = "agent.log"  # file in an agent's folder


@dataclass(frozen=True, slots=True)
class StartFile:
    """Settings of an agent: its printer as in `fleet.yaml`, and the farm's clock.

    Attributes
    ----------
    printer
        The printer's name in the fleet.
    model
        Id of the printer's model.
    port
        The printer's port.
    scale, anchor_s
        See `Clock`.
    power_off_cmd
        Command that cuts the printer's mains; see `PowerOffRun`.
    """

    printer: str
    model: str
    port: str
    scale: float = 1.0
    anchor_s: float = 0.0
    power_off_cmd: str | None = None

    @property
    def clock(self) -> Clock:
        """The farm's clock."""
        return Clock(self.scale, self.anchor_s)

    def dump(self) -> str:
        """Dump the content of the file."""
        return json.dumps(asdict(self))

    def write(self, folder: Path) -> None:
        """Replace the file in one step, unless its content is the same. Raises OSError."""
        with suppress(AgentError):  # an agent must start even on a full disk: heaters may still be on
            if StartFile.read(folder) == self:
                return
        folder.mkdir(parents=True, exist_ok=True)
        temporary = folder / f".{START_FILE}.new"
        temporary.write_text(self.dump())
        temporary.replace(folder / START_FILE)

    @classmethod
    def read(cls, folder: Path) -> StartFile:
        """Read the file in an agent's folder.

        Raises
        ------
        AgentError
            There is no such file, or it cannot be read.
        """
        path = folder / START_FILE
        try:
            raw = json.loads(path.read_text())
            return cls(**{field.name: raw[field.name] for field in fields(cls) if field.name in raw})
        except FileNotFoundError:
            raise AgentError(f"{path}: does not exist; `farm up` starts agents") from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AgentError(f"{path}: cannot be read ({error}); `farm up` replaces it") from None
