"""Agents without printers that only implement the protocol, many in one process.

Each holds the lock of its folder and listens on its own socket, so that a daemon treats it as a running agent
of this host; the service of a host does the same with agents in its folders. Prints begin and end on request
(`ProtocolAgents.end_print`).
"""

from __future__ import annotations

import os
import selectors
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from drivers import messages as m
from drivers.agent.server import Server
from drivers.clock import Clock
from drivers.locks import AGENT_LOCK, acquire_lock

PRINTER_MODEL = "ultimaker2_plus"
PORT = f"sim://{PRINTER_MODEL}"
_IDLE_REPORT_ROUNDS = 5  # an idle agent reports in every fifth round


@dataclass(slots=True)
class _Agent:
    name: str
    clock: Clock
    server: Server = field(init=False)
    print: m.PrintSnapshot | None = None
    nozzle_c: float = 25.0
    bed_clear: bool = True

    def snapshot(self) -> m.Snapshot:
        is_busy = self.print is not None and not self.print.phase.ended
        return m.Snapshot(
            protocol=m.PROTOCOL,
            printer=self.name,
            agent_pid=os.getpid(),
            now_s=self.clock.now(),
            model=PRINTER_MODEL,
            port=PORT,
            link=m.LinkState.BUSY if is_busy else m.LinkState.READY,
            nozzle=m.Heater(now_c=self.nozzle_c, target_c=210.0 if is_busy else 0.0),
            bed=m.Heater(now_c=60.0 if is_busy else 25.0, target_c=60.0 if is_busy else 0.0),
            heaters_off=not is_busy,
            filament=m.Filament.AT_NOZZLE if is_busy else m.Filament.PARKED,
            bed_clear=self.bed_clear,
            print=self.print,
        )

    def answer(self, request: m.Request) -> m.Reply:
        match request:
            case m.StartPrint() if self.print is None:
                self.print = m.PrintSnapshot(
                    print_id=request.print_id,
                    phase=m.PrintPhase.HEATING,
                    print_time_s=request.print_time_s,
                    started_s=self.clock.now(),
                    ends_by_s=request.ends_by_s,
                    sha256=request.sha256,
                    layers=500,
                )
            case m.ForgetPrint() if self.print is not None and self.print.print_id == request.print_id:
                self.print = None
            case m.BedCleared():
                self.bed_clear = True
        return m.Reply(id=request.id, snapshot=self.snapshot())


class ProtocolAgents:
    """Fleet of protocol-only agents, served by one selector.

    Parameters
    ----------
    folders
        Folder of each agent, by name of its printer.
    clock
        The farm's clock.
    """

    def __init__(self, folders: Mapping[str, Path], clock: Clock) -> None:
        self._selector = selectors.DefaultSelector()
        self._agents = {name: _Agent(name, clock) for name in folders}
        self._clock = clock
        self._locks = []
        for agent in self._agents.values():
            folder = folders[agent.name]
            folder.mkdir(parents=True)
            self._locks.append(acquire_lock(folder / AGENT_LOCK))
            agent.server = Server(folder, self._selector, agent.answer, agent.snapshot)

    @property
    def printing_names(self) -> list[str]:
        """Printers with an open print."""
        return [n for n, a in self._agents.items() if a.print is not None and not a.print.phase.ended]

    def is_forgotten(self, name: str) -> bool:
        """Check whether the daemon has recorded the end of a print."""
        return self._agents[name].print is None

    def advance_heating(self) -> None:
        """Advance every heating print to its first layer, and report it."""
        for agent in self._agents.values():
            if agent.print is not None and agent.print.phase is m.PrintPhase.HEATING:
                agent.server.push(agent.snapshot())
                self._update_print(agent, phase=m.PrintPhase.PRINTING, extruded=True, layer=1)

    def end_print(self, name: str) -> None:
        """End a print as done."""
        agent = self._agents[name]
        agent.bed_clear = False
        self._update_print(agent, phase=m.PrintPhase.DONE, ended_s=self._clock.now())

    def report_temperatures(self, name: str) -> None:
        """Send one report with new temperatures and progress."""
        agent = self._agents[name]
        agent.nozzle_c = 209.0 + time.monotonic() % 2.0
        if agent.print is not None and not agent.print.phase.ended:
            self._update_print(agent, progress_s=agent.print.progress_s + 1.0)
        else:
            agent.server.push(agent.snapshot())

    def _update_print(self, agent: _Agent, **changes: object) -> None:
        assert agent.print is not None
        agent.print = agent.print.model_copy(update=changes)
        agent.server.push(agent.snapshot())

    def serve(self, seconds: float, condition: Callable[[], bool] = lambda: False) -> bool:
        """Answer and report for a wall-clock time in s, or until a condition holds; return whether it holds.

        Like real agents, they report every second while they print, and every fifth second otherwise.
        """
        names, printing_agents = list(self._agents), set(self.printing_names)
        start_s, report_count = time.monotonic(), 0
        while (elapsed_s := time.monotonic() - start_s) < seconds:
            if condition():
                return True
            for key, mask in self._selector.select(0.02):
                key.data(mask)
            for number in range(report_count, due_count := int(elapsed_s * len(names))):
                round_number, index = divmod(number, len(names))
                if names[index] in printing_agents or (round_number + index) % _IDLE_REPORT_ROUNDS == 0:
                    self.report_temperatures(names[index])
            report_count = due_count
        return condition()

    def close(self) -> None:
        """Release sockets and locks."""
        for agent in self._agents.values():
            agent.server.close()
        for descriptor in self._locks:
            if descriptor is not None:
                os.close(descriptor)
