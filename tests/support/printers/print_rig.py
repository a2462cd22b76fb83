"""Complete prints on the emulator's firmware, in one process and on a simulated clock."""

import io
import math
import random
from collections.abc import Callable

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.errors import Fault
from drivers.gcode import ProgramStore, read_program, remove_frame
from drivers.link import Link
from drivers.messages import Filament, PrintPhase
from drivers.printers import PROFILES, Profile
from drivers.session import Pace, Session, SessionContext
from printers.link_bench import pass_to_link

PLUS_PROFILE = PROFILES["ultimaker2_plus"]
GCODE = """;FLAVOR:Marlin
G21
G90
M82
M107
M220 S100
M221 S100
M140 S60
G28
G1 F12000 X5 Y10
M190 S60
M109 S210
G1 F2400 Z20
G92 E0
G1 F47 E7.8
G92 E0
;LAYER:0
G0 F9000 X50 Y50 Z0.27
{moves}
;TIME_ELAPSED:100
G1 F1500 E{end:.2f}
M104 S0
M140 S0
M107
G91
G1 F1500 E-13.5
G90
G28
M84
"""


def make_gcode(moves: int = 200) -> str:
    path = "\n".join(f"G1 F3000 X{50 + 40 * (i % 2)} Y{50 + i * 0.2:.2f} E{i + 1}" for i in range(moves))
    return GCODE.format(moves=path, end=moves - 6.5)


class Rig:
    """Link, session and emulated firmware on one clock that advances to the next event."""

    def __init__(
        self,
        faults: Faults = Faults(),  # noqa: B008
        text: str | None = None,
        model: str = "ultimaker2_plus",
        filament: Filament = Filament.PARKED,
        seed: int = 0,
        identity: str | None = None,
        store: ProgramStore | None = None,
        profile: Profile = PLUS_PROFILE,
    ) -> None:
        self.now_s = 1000.0
        self.firmware = EmulatedFirmware(PROFILES[model], faults, random.Random(seed), self.now_s)
        if faults.no_reset:
            self.now_s += 60.0  # the printer was switched on before the print
            self.firmware.feed(b"", self.now_s)
        self.link = Link(profile.firmware, 2.0)
        self.program = read_program(io.BytesIO((text or make_gcode()).encode()), profile, store)
        self.session = Session(
            SessionContext(self.link, self.program, profile, filament, Pace(), self.now_s, identity)
        )
        self.session.context.can_reset_board = not faults.no_reset
        self.is_plugged = True
        self.reconnect_at_s = math.inf  # time at which the cable is plugged in again
        self.sent_bytes = self.next_line = b""
        self.phases = [self.session.context.phase]

    def step(self) -> None:
        session, link = self.session, self.link
        self.is_plugged = self.is_plugged or self.now_s >= self.reconnect_at_s
        if session.context.wants_reset and self.is_plugged:
            session.context.wants_reset = False
            if self.session.context.can_reset_board:
                self.firmware.reset(self.now_s)
            link.on_opened(self.now_s)
            session.advance((), self.now_s)
        sent = self.next_line + link.take()
        self.sent_bytes += sent
        if not sent:
            due_s = min(self.firmware.compute_deadline_s(), link.deadline_s, session.deadline_s)
            due_s = due_s if self.is_plugged else min(due_s, self.reconnect_at_s)
            assert due_s < math.inf, "no event is due"
            self.now_s = max(self.now_s + 1e-4, due_s)
        else:
            self.now_s += 0.005
        answer = self.firmware.feed(sent if self.is_plugged else b"", self.now_s)
        self.next_line, events = b"", ()
        if answer and self.is_plugged:
            self.next_line, events = pass_to_link(link, answer, self.now_s)
        events = [*events, *link.tick(self.now_s)]
        session.advance(events, self.now_s)
        if session.context.phase is not self.phases[-1]:
            self.phases.append(session.context.phase)

    def run(self, until: Callable[[], bool] = lambda: False, limit_s: float = 20_000.0) -> "Rig":
        while not self.session.context.has_ended and not until():
            assert self.now_s < 1000.0 + limit_s, "the print does not end"
            self.step()
        return self

    def read_targets(self) -> tuple[float, float]:
        board = self.firmware.board
        return board.nozzle.target_c, board.bed.target_c

    def run_until_printing(self, lines: int = 100) -> "Rig":
        return self.run(until=lambda: self.session.context.acknowledged_line_count >= lines)

    def list_moves(self) -> list[bytes]:
        """List the sent moves of the file in the order of their line numbers."""
        frames = (line for line in self.sent_bytes.splitlines() if line.startswith(b"N"))
        commands_by_number = {line.partition(b" ")[0]: remove_frame(line) for line in frames}
        file = set(self.program.read_lines(0, self.program.line_count))
        return [
            command
            for command in commands_by_number.values()
            if command.startswith(b"G1 ") and command in file
        ]


def make_retracting_gcode(moves: int) -> str:
    """Make G-code with a retraction, a travel and an unretraction after every stroke."""
    path = []
    for i in range(moves):
        e_mm, x = 0.7 * (i + 1), 50 + 40 * (i % 2)
        path.append(f"G1 F1500 X{x} Y{50 + i * 0.2:.2f} E{e_mm:.5f}\nG1 F1500 E{e_mm - 6.5:.5f}")
        path.append(f"G0 F9000 X{x} Y{52 + i * 0.2:.2f}\nG1 F1500 E{e_mm:.5f}")
        if not i % 50:
            path.append("G92 E0\nG1 F600 E-1\nG92 E%.5f" % (e_mm - 1))
    return GCODE.format(moves="\n".join(path), end=0.7 * moves - 6.5)


def assert_end_with_heaters_off(rig: Rig, phase: PrintPhase, fault: Fault | None) -> None:
    session = rig.session
    assert (session.context.phase, session.context.fault) == (phase, fault), session.context.reason
    assert session.context.heaters_off and not session.context.wants_power_off
    assert rig.read_targets() == (0.0, 0.0)
    assert session.context.ended_s is not None and rig.now_s - 120.0 < session.context.ended_s <= rig.now_s
