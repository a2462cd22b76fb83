"""Start file of an agent: whoever starts it writes the file into its folder."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from drivers.clock import Clock
from drivers.errors import AgentError

FILE = "start.json"


@dataclass(frozen=True, slots=True)
class Start:
    """An agent's printer, as `fleet.yaml` has it, and the farm's clock."""

    printer: str
    model: str
    port: str
    scale: float = 1.0
    anchor_s: float = 0.0
    power_off_cmd: str | None = None

    @property
    def clock(self) -> Clock:
        return Clock(self.scale, self.anchor_s)

    def text(self) -> str:
        """Dump it as the file holds it."""
        return json.dumps(asdict(self))

    def write(self, folder: Path) -> None:
        """Put the file in place in one step; one that says the same stays as it is. Raises OSError."""
        with suppress(AgentError):  # on a full disk the agent that ends the last one's heat has to start
            if read(folder) == self:
                return
        folder.mkdir(parents=True, exist_ok=True)
        spare = folder / f".{FILE}.new"
        spare.write_text(self.text())
        spare.replace(folder / FILE)


def read(folder: Path) -> Start:
    """Read what the agent of this folder was started with last.

    Raises
    ------
    AgentError
        There is no such file, or it is not one of ours.
    """
    path = folder / FILE
    try:
        raw = json.loads(path.read_text())
        return Start(**{field.name: raw[field.name] for field in fields(Start)})
    except FileNotFoundError:
        raise AgentError(f"{path}: is not there; `farm up` starts agents") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise AgentError(f"{path}: cannot be read ({error}); `farm up` writes it anew") from None
