"""The links to the agents: starting and adopting them, sending instructions, hearing snapshots."""

from __future__ import annotations

import asyncio
import base64
import logging
import subprocess
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from drivers import messages as m
from drivers.agent.heartbeat import Heartbeat, look_at
from drivers.clock import Clock
from drivers.emulator.launch import Command, control
from drivers.emulator.launch import alive as emulator_alive
from drivers.errors import AgentError, AgentTooOld, DriverError
from drivers.remote import bridge
from drivers.remote import client as agents
from drivers.remote.client import AgentClient, alive, spawn
from farm.agents.protocol_adapter import on_its_clock, shift_s, translate, translate_print
from farm.agents.remote import Way, forget, kept_way, reaching
from farm.config import Fleet, PrinterSection
from farm.errors import FarmError, NoSuchThing, Refused
from farm.model import AgentPrint, AgentSnapshot, Link
from farm.paths import StateFolder
from farm.scheduling.situation_builder import Span
from farm.state import events as ev
from farm.state.books import Books

log = logging.getLogger(__name__)

_RESTARTS_PER_MINUTE = 6  # an agent that dies more often than this is left alone for a while
_SILENCE_S = 30.0  # wall seconds; an agent that is well says something every 5
_END_S = 30.0  # wall seconds for an idle agent to end
_LONGEST_WAIT_S = 15.0  # wall seconds between two tries to reach an agent
_STEADY_S = 30.0  # wall seconds after which a connection that ends was a good one
_OLD = "its agent is of an older version: replace it by `farm up --replace {}`"
_PIECE_BYTES = 32 * 1024  # of a file on its way there; an agent takes lines of 64 KiB
_START_S = 120.0  # wall seconds; a start that takes longer on its way is decided anew
_CLEARED = ("cleared", "")  # how a `BedCleared` on its way is known
_EMULATOR = "emulator"  # the agent's folder for the emulator of a sim:// port


class Ears(Protocol):
    """Who is told what the agents say."""

    def heard(self, snapshot: AgentSnapshot) -> None: ...

    def refused(self, print_id: str, reason: str, late: bool) -> None: ...

    def unreported_since_s(self, printer: str) -> float | None: ...

    def recounted(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None: ...


class Links:
    """All agents of the fleet."""

    def __init__(self, fleet: Fleet, state: StateFolder, clock: Clock, ears: Ears) -> None:
        self._state, self._clock, self._ears = state, clock, ears
        self._strangers: asyncio.Task[None] | None = None
        self._links = {
            section.name: AgentLink(section.name, section, state, clock, ears, fleet.fleet.name)
            for section in fleet.printers
            if section.enabled
        }

    def start(self, printing: Iterable[str]) -> None:
        """Adopt the agents that are alive, start the others, and listen to all.

        `printing` are the printers on which the books have an open print: their agents are listened to even
        where a person has taken the printer out of `fleet.yaml`.
        """
        for name in printing:
            if name not in self._links:
                self._links[name] = AgentLink(name, None, self._state, self._clock, self._ears)
        for link in self._links.values():
            link.start()
        self._strangers = asyncio.create_task(self._end_strangers())

    async def _end_strangers(self) -> None:
        """End idle agents of printers that are no longer in the fleet: another name may need their ports."""
        for folder in sorted((self._state.root / "agents").glob("*/")):
            if folder.name in self._links:
                continue
            way = reaching(kept_way(folder, None, "", self._clock))
            if way is not None or alive(folder):
                await self._end_stranger(folder, way)

    async def _end_stranger(self, folder: Path, way: Way | None) -> None:
        client, ended = AgentClient(folder, way), False
        try:
            await client.connect()
            reply = await client.request(m.Shutdown(id=0))
            log.info("%s is not in the fleet: its agent %s", folder.name, reply.error or "ends")
            ended = reply.error is None
        except DriverError as error:
            ended = bridge.NOBODY in str(error)
            if not ended:
                log.warning("%s is not in the fleet, and its agent does not answer: %s", folder.name, error)
        finally:
            await client.close()
        if ended:
            forget(folder)

    def watch(self) -> None:
        """Start what has died."""
        for link in self._links.values():
            link.keep_alive()

    def perform(
        self, instruction: ev.AnyInstruction, books: Books, files: Path, span_of: Callable[[str], Span]
    ) -> None:
        """Tell an agent; where it cannot be told now, its next snapshot shows that it still has to be."""
        match instruction:
            case ev.SendStart():
                attempt = books.prints[instruction.print_id]
                plate = books.plates[attempt.plate]
                span = span_of(attempt.id)
                request: m.Request = m.StartPrint(
                    id=0,
                    print_id=attempt.id,
                    gcode=str(files / plate.gcode),
                    sha256=plate.sha256,
                    print_time_s=plate.sliced_s,
                    filament=m.Filament(books.printer(instruction.printer).filament),
                    not_after_s=span.not_after_s,
                    ends_by_s=span.ends_by_s,
                )
            case ev.SendEndBy():
                request = m.EndPrintBy(id=0, print_id=instruction.print_id, ends_by_s=instruction.ends_by_s)
            case ev.SendCancel():
                request = m.CancelPrint(id=0, print_id=instruction.print_id, reason=instruction.reason)
            case ev.SendPause():
                pause = m.PausePrint if instruction.wanted else m.ResumePrint
                request = pause(id=0, print_id=instruction.print_id)
            case ev.SendForget():
                request = m.ForgetPrint(id=0, print_id=instruction.print_id)
            case ev.SendCleared():
                filament = m.Filament(instruction.filament) if instruction.filament else None
                request = m.BedCleared(id=0, filament=filament)
            case ev.StopPlanning() | ev.NameFiles():
                return
        link = self._links.get(instruction.printer)
        if link is not None:
            link.tell(request)

    async def replace(self, name: str) -> None:
        """Replace the agent of an idle printer. Raises NoSuchThing or Refused."""
        link = self._links.get(name)
        if link is None:
            raise NoSuchThing(f"no printer {name} is in use; see `farm status`")
        try:
            await link.replace()
        except DriverError as error:
            raise Refused(str(error)) from error

    async def shut_down_agents(self) -> None:
        """End every agent, and switch the simulated printers off."""
        await asyncio.gather(*(link.shut_down() for link in self._links.values()))

    async def close(self) -> None:
        """Leave the agents to themselves."""
        if self._strangers is not None:
            self._strangers.cancel()
            await asyncio.gather(self._strangers, return_exceptions=True)
        await asyncio.gather(*(link.close() for link in self._links.values()))


class AgentLink:
    """One agent: its process, its connection, and what it is told. Without a section it is only adopted."""

    def __init__(
        self,
        name: str,
        section: PrinterSection | None,
        state: StateFolder,
        clock: Clock,
        ears: Ears,
        farm: str = "",
    ) -> None:
        self._name = name
        self._section = section
        self._folder = state.agent(name)
        self._clock = clock
        self._ears = ears
        way = kept_way(self._folder, section, farm, clock)
        self._remote = way is not None
        self._heartbeat = Heartbeat()
        self._client = AgentClient(self._folder, way, self._heartbeat.heard)
        self._process: subprocess.Popen[bytes] | None = None
        self._starts: deque[float] = deque(maxlen=_RESTARTS_PER_MINUTE)
        self._asked: set[tuple[str, str]] = set()  # requests on their way: not sent twice at a time
        self._unknown: set[tuple[str, str]] = set()  # requests that its agent is too old for
        self._cancelled: set[str] = set()  # prints that must not be begun any more
        self._tasks: set[asyncio.Task[Any]] = set()
        self._apart_s = 0.0  # what our clock was ahead of the agent's before anybody set it
        self._stopping = False

    @property
    def _ahead_s(self) -> float:
        """What our clock is ahead of the agent's."""
        return self._apart_s + self._clock.ahead_s

    def start(self) -> None:
        self.keep_alive()
        self._spawn_task(self._listen())

    def keep_alive(self) -> None:
        """Start the agent where none is alive; end one that is wedged."""
        if self._process is not None and self._process.poll() is not None:
            if self._process.returncode or not agents.as_units():  # else systemd has started it
                log.warning("%s: its agent ended with %s", self._name, self._process.returncode)
            self._process = None
        if self._stopping or self._remote:
            return  # the bridge on the other host starts and watches it
        if self._process is not None or alive(self._folder):
            self._look_for_life()
            return
        if self._section is None:
            gone = "it was taken out of fleet.yaml, and its agent is gone"
            self._hear(AgentSnapshot(printer=self._name, link=Link.ABSENT, reason=gone))
            return
        now = time.monotonic()
        if len(self._starts) == self._starts.maxlen and now - self._starts[0] < 60.0:
            return
        self._starts.append(now)
        self._heartbeat.heard()
        try:
            section = self._section
            self._process = spawn(
                section.name,
                section.model,
                section.port,
                self._folder,
                self._clock,
                section.power_off_cmd,
            )
            log.info("%s: agent started, pid %d", section.name, self._process.pid)
        except DriverError as error:
            self._hear(AgentSnapshot(printer=self._name, link=Link.ABSENT, reason=str(error)))

    def _look_for_life(self) -> None:
        """Kill an agent that is wedged; the next look starts another, which resets the board."""
        pid = agents.pid(self._folder)
        if pid is not None and self._heartbeat.wedged(time.monotonic(), lambda: look_at(pid)):
            log.error("%s: its agent (pid %d) is wedged: replacing it", self._name, pid)
            self._spawn_task(self._kill())

    async def _kill(self) -> None:
        if not await asyncio.to_thread(agents.kill, self._folder):
            log.error("%s: its agent cannot be killed; switch the printer off", self._name)

    async def _listen(self) -> None:
        wait_s = 0.0
        while not self._stopping:
            try:
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s + (1.0 if self._remote else agents.RETRY_S), _LONGEST_WAIT_S)
                await self._client.connect()
                connected_s = time.monotonic()
                words = self._client.snapshots()
                while True:
                    async with asyncio.timeout(_SILENCE_S):
                        said = await anext(words, None)
                    if said is None:
                        break
                    self._apart_s = shift_s(said, self._clock) - self._clock.ahead_s
                    if self._is_ours(said):
                        said = await self._recount(said)
                        self._hear(self._believed(said))
                if time.monotonic() - connected_s > _STEADY_S:
                    wait_s = 0.0
                log.info("%s: the connection to its agent is gone", self._name)
            except TimeoutError:
                log.warning("%s: its agent has said nothing for %g s", self._name, _SILENCE_S)
            except (DriverError, FarmError) as error:
                log.warning("%s: %s", self._name, error)
            except Exception:
                log.exception("%s: listening to its agent", self._name)
            self._hear(AgentSnapshot(printer=self._name, link=Link.STARTING))

    async def _recount(self, said: m.Snapshot) -> m.Snapshot:
        """Where the books are a copy, have it say what it printed since. Its latest word."""
        since_s = self._ears.unreported_since_s(self._name)
        if since_s is None:
            return said
        request = on_its_clock(m.ListPrints(id=0, since_s=since_s), self._ahead_s, self._clock.now())
        try:
            reply = await self._client.request(request)
        except AgentTooOld:
            return said
        latest = reply.snapshot or said
        prints = [translate_print(one, self._ahead_s) for one in reply.prints]
        self._ears.recounted(self._believed(latest), prints)
        return latest

    def _hear(self, snapshot: AgentSnapshot) -> None:
        if snapshot.agent_pid is not None and self._ears.unreported_since_s(self._name) is not None:
            return  # first what it printed since
        try:
            self._ears.heard(snapshot)
        except FarmError as error:
            # The books could not be written: nothing was changed, and the next word is taken afresh.
            log.error("%s: %s", self._name, error)
        except Exception:  # a fault of ours must not leave this printer without anybody who listens
            log.exception("%s: booking what its agent said", self._name)

    def _believed(self, said: m.Snapshot) -> AgentSnapshot:
        """What an agent says, of this printer alone, whatever it calls itself; not all of it is believed."""
        changes: dict[str, object] = {"printer": self._name}
        if self._section is None or not self._section.simulated:
            changes["bed_clear"] = None  # only an emulator can tell
        if _CLEARED in self._asked:
            changes["bed_unknown_reason"] = changes["alarm"] = (
                None  # a person has just dispelled it: this was on its way meanwhile
            )
        if said.protocol < m.StartPrint.needed and said.print is None:
            changes |= {"link": Link.FAULT, "reason": _OLD.format(self._name), "outdated": True}
        return translate(said, self._clock).model_copy(update=changes)

    def _is_ours(self, said: m.Snapshot) -> bool:
        """Whether the agent was started for what `fleet.yaml` says; an idle one that was not is replaced."""
        section = self._section
        if section is None or (said.model, said.port) == (section.model, section.port):
            return True
        if said.print is not None:
            return True  # what it prints is in the books: first that
        log.warning("%s: its agent has %s at %s: replacing it", self._name, said.model, said.port)
        self._spawn_task(self._end_agent())
        return False

    def tell(self, request: m.Request) -> None:
        """Send a request; its refusal or loss is logged, and the next snapshot shows what is still owed."""
        key = (request.do, getattr(request, "print_id", ""))
        if isinstance(request, m.CancelPrint):
            self._cancelled.add(request.print_id)
        if key not in self._asked:
            self._asked.add(key)
            self._spawn_task(self._tell(key, request))

    async def _tell(self, key: tuple[str, str], request: m.Request) -> None:
        try:
            if self._remote and isinstance(request, m.StartPrint) and request.gcode:
                await self._upload(request.print_id, Path(request.gcode))
                if request.print_id in self._cancelled:
                    return  # while it was sent
                request = request.model_copy(update={"gcode": None})
            latest_s = self._clock.now() + _START_S * self._clock.scale
            reply = await self._client.request(on_its_clock(request, self._ahead_s, latest_s))
            if reply.error:
                log.warning("%s: %s refused: %s", self._name, request.do, reply.error)
                if isinstance(request, m.StartPrint):
                    self._ears.refused(request.print_id, reply.error, reply.late)
            elif isinstance(request, m.CancelPrint) and reply.snapshot is not None:
                said = self._believed(reply.snapshot)
                self._hear(said.model_copy(update={"heard_cancel": request.print_id}))
        except AgentTooOld as error:
            if key not in self._unknown:
                log.warning("%s: %s", self._name, error)
            self._unknown.add(key)
            if isinstance(request, m.StartPrint):
                self._ears.refused(request.print_id, str(error), True)
        except (DriverError, FarmError) as error:
            log.warning("%s: %s", self._name, error)
        finally:
            self._asked.discard(key)

    async def _upload(self, print_id: str, gcode: Path) -> None:
        """Send a file to an agent that has no disk in common with us. Raises DriverError."""
        at, more = 0, True
        try:
            with gcode.open("rb") as file:
                while more:
                    piece = await asyncio.to_thread(file.read, _PIECE_BYTES)
                    sent = m.Upload(id=0, print_id=print_id, at=at, data=base64.b64encode(piece))
                    reply = await self._client.request(sent)
                    if reply.error:
                        raise AgentError(reply.error)
                    at, more = at + len(piece), bool(piece)
        except OSError as error:
            raise AgentError(f"{gcode}: cannot be read ({error})") from error

    async def replace(self) -> None:
        """End an agent that prints nothing; one of this version starts in its place.

        Raises
        ------
        AgentError
            It prints, or cannot be reached.
        """
        reply = await self._client.request(m.Shutdown(id=0))
        if reply.error:
            raise AgentError(f"{self._name}: {reply.error}")

    async def shut_down(self) -> None:
        """End the agent for good; a simulated printer is switched off."""
        self._stopping = True
        await self._end_agent()

    async def _end_agent(self) -> None:
        try:
            reply = await self._client.request(m.Shutdown(id=0, now=True))
            if reply.error:
                log.warning("%s: %s", self._name, reply.error)
        except DriverError as error:
            log.info("%s: %s", self._name, error)
        try:
            async with asyncio.timeout(_END_S):
                while alive(self._folder):
                    await asyncio.sleep(0.05)
        except TimeoutError:
            log.warning("%s: its agent does not end", self._name)
        else:
            if self._process is not None:
                await asyncio.to_thread(self._process.wait)
        if emulator_alive(self._folder / _EMULATOR):
            try:
                await asyncio.to_thread(control, self._folder / _EMULATOR, Command.POWER_OFF)
            except DriverError as error:
                log.warning("%s: %s", self._name, error)

    async def close(self) -> None:
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._client.close()

    def _spawn_task(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
