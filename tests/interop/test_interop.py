"""Interoperation with OctoPrint's virtual printer and Printrun's printcore.

Both are in a separate environment, which `make interop` creates; without it, these tests are skipped.
"""

import io
import os
import select
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

import pytest

from drivers.clock import Clock
from drivers.emulator.launch import Command, control, launch, read_status
from drivers.errors import Fault, PortError
from drivers.firmware import MARLIN2, ULTIMAKER2, Firmware
from drivers.gcode import read_program
from drivers.link import Link, LinkFault, Phase
from drivers.messages import Filament, PrintPhase
from drivers.ports import SerialPort
from drivers.printers import PROFILES
from drivers.session import Pace, Session, SessionContext
from printers.agent_with_emulator import wait_for_emulator
from printers.link_bench import pass_to_link

PEERS = Path(__file__).parent / "peers"
PYTHON = Path(os.environ.get("FARM_INTEROP", "none"))  # Python of the separate environment
TIME_SCALE = 10.0  # of our time-outs; those of the virtual printer are in real seconds
TIME_LIMIT_S = 120.0

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not PYTHON.exists(), reason="the peers are missing: make interop"),
]


@contextmanager
def open_octoprint(folder: Path, *faults: str, firmware: Firmware = ULTIMAKER2) -> Iterator[SerialPort]:
    """Open the port of a virtual printer; each fault is NAME@LINE."""
    name = "marlin2" if firmware is MARLIN2 else "ultimaker2"
    peer = subprocess.Popen(
        [PYTHON, PEERS / "octoprint_peer.py", folder, name, *faults],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert peer.stdin is not None and peer.stdout is not None
    try:
        port = SerialPort(Path(peer.stdout.readline().strip()), firmware.baud_rate)
        peer.stdin.write("the port is open\n")
        peer.stdin.flush()
        yield port
        port.close()
    finally:
        peer.kill()
        peer.wait()
        peer.stdin.close()
        peer.stdout.close()


def print_program(
    folder: Path, program: list[bytes], *injected_faults: str, firmware: Firmware = ULTIMAKER2
) -> tuple[Link, list[Fault]]:
    """Print on a virtual printer until the program or the link ends; return the link and its faults."""
    clock = Clock(TIME_SCALE, time.time())
    link, is_connected = Link(firmware, 2.0 * TIME_SCALE), False
    faults: list[Fault] = []
    link.poll_interval_s = 10.0
    with open_octoprint(folder, *injected_faults, firmware=firmware) as port:
        deadline_s = time.monotonic() + TIME_LIMIT_S
        link.on_opened(clock.now())
        while not faults and not (is_connected and link.is_drained):
            assert time.monotonic() < deadline_s, f"the print does not end: {link.streamed_line_count} lines"
            wait_s = max(0.0, min(clock.to_wall_duration_s(link.deadline_s - clock.now()), 1.0))
            try:
                data = port.read() if select.select([port.fileno()], [], [], wait_s)[0] else b""
                port.write(link.take())
                now_s = clock.now()
                line, events = pass_to_link(link, data, now_s)
                port.write(line)
                events = [*events, *link.tick(now_s)]
                faults += [event.fault for event in events if isinstance(event, LinkFault)]
                if not is_connected and link.phase is Phase.LIVE:
                    is_connected = True
                    link.stream(now_s, lambda a, b: program[a:b], 0, len(program))
                port.write(link.take())
            except PortError:  # by a read or, when the port goes after it, by any of the writes
                return link, [Fault.PORT_LOST]
    return link, faults


def make_spiral(count: int) -> list[bytes]:
    return [
        b"G1 F9000 X%.2f Y%.2f E%.3f" % (50 + i % 90 * 0.3, 50 + i * 0.05, i * 0.01) for i in range(count)
    ]


def read_executed_commands(folder: Path) -> list[bytes]:
    """Return the commands that the virtual printer executed, without resent lines."""
    lines = (folder / "done.txt").read_bytes().replace(b"  ", b" ").splitlines()  # see `add_frame`
    return [line for line, _ in groupby(lines)]


def test_virtual_printer_prints_to_the_end_with_its_faults(tmp_path: Path):
    """Print with the virtual printer's default errors (lines 100 to 115) and its debug commands."""
    program = make_spiral(600)
    link, faults = print_program(
        tmp_path,
        program,
        "dont_answer@150",
        "prepare_ok o@200",
        "trigger_missing_lineno@230",
        "trigger_resend_checksum@260",
        "trigger_resend_lineno@300",
        "trigger_missing_checksum@340",
        "sleep 3@380",
        "send echo:busy: processing@390",
        "send // action:nothing@395",
        "resend_ratio 2@420",
    )
    assert faults == []
    assert link.streamed_line_count == len(program)
    printed_lines = read_executed_commands(tmp_path)
    assert printed_lines == [line for line in program if line in set(printed_lines)]
    dropped_lines = (tmp_path / "dropped.txt").read_text().splitlines()
    # Only lines that the virtual printer dropped are missing; a dropped line may also be an M105.
    assert len(program) - len(printed_lines) <= len(dropped_lines)
    assert link.resend_count >= 8  # no line is repeated after a lost ok


def test_virtual_printer_as_marlin_2_prints_to_the_end_with_its_faults(tmp_path: Path):
    """Print with numbered oks, busy messages, and the answer of Marlin 2 to the query."""
    program = make_spiral(600)
    link, faults = print_program(
        tmp_path,
        program,
        "dont_answer@150",
        "trigger_resend_checksum@260",
        "trigger_resend_lineno@300",
        "trigger_missing_checksum@340",
        "sleep 3@380",
        "resend_ratio 2@420",
        firmware=MARLIN2,
    )
    assert faults == []
    assert link.streamed_line_count == len(program)
    printed_lines = read_executed_commands(tmp_path)
    assert printed_lines == [line for line in program if line in set(printed_lines)]
    dropped_lines = (tmp_path / "dropped.txt").read_text().splitlines()
    assert len(program) - len(printed_lines) <= len(dropped_lines)


def test_session_prints_a_part_to_a_virtual_ender_3(tmp_path: Path):
    """Identify the printer, heat, print every line, and confirm that the heaters are off."""
    profile, moves = PROFILES["creality_ender3"], make_spiral(300)
    start = "\n".join(profile.start_code).format(bed_c=40.0, nozzle_c=190.0, prime_mm=5.0)
    end = "\n".join(profile.end_code).format(park_mm=-profile.park_retraction_mm)
    text = b"\n".join((start.encode(), b";LAYER:0", *moves, end.encode()))
    clock = Clock(TIME_SCALE, time.time())
    link = Link(MARLIN2, 2.0 * TIME_SCALE)
    program = read_program(io.BytesIO(text + b"\n"), profile)
    context = SessionContext(link, program, profile, Filament.PARKED, Pace.from_clock(clock), clock.now())
    session = Session(context)
    with open_octoprint(tmp_path, firmware=MARLIN2) as port:
        link.on_opened(clock.now())
        session.on_port_reset()
        deadline_s = time.monotonic() + TIME_LIMIT_S
        while not context.has_ended:
            assert time.monotonic() < deadline_s, f"{context.phase}, {context.acknowledged_line_count} lines"
            due_s = min(link.deadline_s, session.deadline_s) - clock.now()
            wait_s = max(0.0, min(clock.to_wall_duration_s(due_s), 1.0))
            data = port.read() if select.select([port.fileno()], [], [], wait_s)[0] else b""
            now_s = clock.now()
            line, events = pass_to_link(link, data, now_s)
            port.write(line)
            session.advance([*events, *link.tick(now_s)], now_s)
            assert not context.wants_reset, context.reason
            port.write(link.take())
    assert (context.phase, context.fault) == (PrintPhase.DONE, None), context.reason
    assert context.heaters_off and context.filament is Filament.PARKED
    file = set(moves)
    assert [line for line in read_executed_commands(tmp_path) if line in file] == moves


@pytest.mark.parametrize(
    ("trigger", "fault"),
    [
        ("go_awol", Fault.NO_ANSWER),
        ("rerequest_last", Fault.NOISY_LINE),
        ("trigger_fatal_error_marlin", Fault.KILL),
        ("mintemp_error", Fault.MINTEMP),
        ("maxtemp_error", Fault.MAXTEMP),
        ("reset", Fault.REBOOT),
        ("drop_connection", Fault.PORT_LOST),
    ],
)
def test_unrecoverable_fault_of_the_virtual_printer_is_reported(tmp_path: Path, trigger: str, fault: Fault):
    program = make_spiral(200)
    _, faults = print_program(tmp_path, program, f"{trigger}@60")
    assert faults == [fault]
    assert program[: len(read_executed_commands(tmp_path))] == read_executed_commands(tmp_path)


@pytest.mark.parametrize("faults", ["", "?resend=0.01"])
def test_printcore_prints_to_the_emulator_to_the_end(tmp_path: Path, faults: str):
    path = tmp_path / "spiral.gcode"
    moves = make_spiral(1500)
    path.write_bytes(b"\n".join([b"M302 S0", b"G28", b"G92 E0", *moves, b"M400"]) + b"\n")
    emulator = tmp_path / "emulator"
    tty = launch(f"sim://ultimaker2_plus{faults}", emulator, Clock(TIME_SCALE, time.time()))
    try:
        subprocess.run([PYTHON, PEERS / "printcore_peer.py", tty, path], check=True, timeout=TIME_LIMIT_S)
        # On a busy computer, printcore disconnects before the last moves have ended.
        wait_for_emulator(emulator, lambda status: status.moves >= len(moves))
        status = read_status(emulator)
    finally:
        control(emulator, Command.POWER_OFF)
    assert status.moves == len(moves)
    assert status.filament_mm == pytest.approx(1499 * 0.01)
    assert status.position_mm[:2] == pytest.approx((50 + 1499 % 90 * 0.3, 50 + 1499 * 0.05), abs=0.001)
    assert (status.errors > 0) == bool(faults)
