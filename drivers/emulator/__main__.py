"""Run an emulator (``python -m drivers.emulator``): one loop over port, control socket and clock."""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import random
import select
import signal
import socket
import sys
import time
from collections import deque
from pathlib import Path
from types import FrameType
from typing import IO, Any

from drivers.clock import Clock
from drivers.emulator.faults import COUNTED_FAULTS, Faults, parse_faults
from drivers.emulator.firmware import person
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.emulator.hardware.wire import Wire
from drivers.emulator.launch import ALIVE_LOCK, CONTROL_SOCKET, LOG_FILE, TTY_LINK, Command, shorten_path
from drivers.emulator.port import Port
from drivers.emulator.status import EmulatorStatus, write_status
from drivers.errors import PortError
from drivers.log_file import rotate_log
from drivers.printers import PROFILES, Profile

STATUS_INTERVAL_S = 0.4  # wall seconds between two status writes; readers expect one every 0.5 s
CONTROL_TIMEOUT_S = 0.5
PIECE_BYTES = 2  # size of the pieces of an answer
# Wall seconds by which an accelerated emulator may delay an ok while its planner is full.
MAX_OK_DELAY_S = 0.002


class Emulator:
    """The firmware with its port and its control socket.

    The firmware's own clock starts at 0 at power-on: only a small float has a precision of microseconds.

    Parameters
    ----------
    profile
        The printer model.
    faults
        Faults to inject.
    seed
        Seed of the random faults.
    folder
        Folder of the emulator's port, status and control socket.
    clock
        The farm's clock.
    """

    def __init__(self, profile: Profile, faults: Faults, seed: int, folder: Path, clock: Clock) -> None:
        self._profile = profile
        self._folder = folder
        self._clock = clock
        self._origin_s = clock.now()
        baud_rate = profile.firmware.baud_rate
        # One wire from the host, one to the host.
        self._wires = (Wire(baud_rate), Wire(baud_rate)) if faults.wire else None
        self._firmware = EmulatedFirmware(profile, faults, random.Random(seed), 0.0)
        self._port = Port(folder / TTY_LINK)
        self._control = _open_control_socket(folder)
        self._bytewise = faults.bytewise
        self._pieces: deque[bytes] = deque()
        self._is_on = True
        self._published_change_count = -1
        self._status_due_s = 0.0
        self.publish_status(0.0)

    def run(self) -> None:
        """Serve until switched off."""
        firmware, port, control_fd = self._firmware, self._port, self._control.fileno()
        clock, board = self._clock, self._firmware.board
        scale, wires = clock.scale, self._wires
        max_delay_s = MAX_OK_DELAY_S * scale if scale > 1.0 else 0.0
        now_s = 0.0
        while self._is_on:
            due_s = firmware.compute_deadline_s(max_delay_s)
            if wires is not None:
                due_s = min(due_s, wires[0].compute_due_s(), wires[1].compute_due_s())
            wait_s = min((due_s - now_s) / scale, self._status_due_s - time.monotonic())
            if self._pieces:
                wait_s = 0.0
            sources = [
                control_fd,
                *([port.watch_fd] if port.is_plugged else ()),
                *([port.master_fd] if port.is_open else ()),
            ]
            ready = select.select(sources, (), (), max(0.0, wait_s))[0]
            now_s = max(now_s, clock.now() - self._origin_s)
            data = b""
            if ready:
                if port.is_plugged and port.watch_fd in ready:
                    self._process_port_events(now_s)
                elif port.is_open and port.master_fd in ready:
                    data = port.read()
                if control_fd in ready:
                    self._serve_control(now_s)
            if wires is not None:
                wires[0].put(data, now_s)
                data = wires[0].take(now_s)
            data_out = firmware.feed(data, now_s)
            if wires is not None:
                wires[1].put(data_out, now_s)
                data_out = wires[1].take(now_s)
            if self._bytewise:
                self._pieces.extend(
                    data_out[i : i + PIECE_BYTES] for i in range(0, len(data_out), PIECE_BYTES)
                )
                data_out = self._pieces.popleft() if self._pieces else b""
            if data_out:
                port.write(data_out)
            if board.change_count != self._published_change_count or time.monotonic() >= self._status_due_s:
                self.publish_status(now_s)
        firmware.machine.power_down(now_s)
        port.unplug()
        self.publish_status(now_s)

    def switch_off(self) -> None:
        """Make `run` return."""
        self._is_on = False

    def publish_status(self, now_s: float) -> None:
        """Write the status; switch off if the folder was removed."""
        firmware, board = self._firmware, self._firmware.board
        x, y, z, _ = firmware.machine.planner.compute_position(now_s)
        status = EmulatorStatus(
            pid=os.getpid(),
            model=self._profile.model,
            tty=self._port.name,
            link_open=self._port.is_open,
            phase=firmware.phase,
            time_s=self._origin_s + now_s,
            nozzle_c=round(board.nozzle.compute_temperature_c(now_s), 2),
            nozzle_target_c=board.nozzle.target_c,
            bed_c=round(board.bed.compute_temperature_c(now_s), 2),
            bed_target_c=board.bed.target_c,
            position_mm=(round(x, 4), round(y, 4), round(z, 4)),
            homed=firmware.machine.is_homed,
            filament_mm=round(board.filament_mm, 4),
            filament_end_mm=round(board.filament_end_mm, 4),
            bed_clear=board.bed_clear,
            starvation_s=round(firmware.starvation_s, 4),
            moves=firmware.move_count,
            lines=firmware.line_count,
            errors=firmware.error_count,
            resets=firmware.reset_count,
            printing_s=round(firmware.moving_s, 4),
            damaged_byte_count=firmware.noise.damaged_byte_count if firmware.noise is not None else 0,
            altered_line_count=firmware.noise.altered_line_count if firmware.noise is not None else 0,
        )
        try:
            write_status(self._folder, status)
        except OSError:
            self._is_on = self._folder.is_dir()  # on a full disk, the last status remains
        rotate_log(self._folder / LOG_FILE)
        self._published_change_count = board.change_count
        self._status_due_s = time.monotonic() + STATUS_INTERVAL_S

    def _process_port_events(self, now_s: float) -> None:
        """Handle openings and closings of the port by the host: opening resets the board."""
        was_open = self._port.is_open
        if self._port.process_port_events() and not self._firmware.board.faults.no_reset:
            self._port.discard_bytes()
            for wire in self._wires or ():
                wire.clear()
            self._firmware.feed(b"", now_s)
            self._firmware.reset(now_s)
        if self._port.is_open != was_open:
            self._firmware.board.change_count += 1

    def _serve_control(self, now_s: float) -> None:
        """Execute one command from the control socket."""
        try:
            connection, _ = self._control.accept()
            with connection:
                connection.settimeout(CONTROL_TIMEOUT_S)
                with connection.makefile("rb") as requests:
                    answer = self._execute_command(json.loads(requests.readline()), now_s)
                self.publish_status(now_s)
                connection.sendall(json.dumps(answer).encode() + b"\n")
        except (OSError, ValueError, KeyError) as error:
            print(f"control: {error}", file=sys.stderr)  # noqa: T201 - its log

    def _execute_command(self, request: dict[str, Any], now_s: float) -> dict[str, Any]:
        match request.get("do"):
            case Command.CLEAR_BED:
                self._firmware.board.clear_bed()
            case Command.RESET:
                self._firmware.feed(b"", now_s)
                self._firmware.reset(now_s)
            case Command.POWER_OFF:
                self.switch_off()
            case Command.SET_NOZZLE:
                person.set_nozzle_target(self._firmware, float(request["target_c"]), now_s)
            case Command.SET_BED:
                person.set_bed_target(self._firmware, float(request["target_c"]), now_s)
            case Command.MOVE:
                person.move_bed(self._firmware, float(request["z_mm"]), now_s)
            case Command.PRINT_SD:
                person.print_sd(self._firmware, now_s)
            case Command.BREAK:
                if request["fault"] not in COUNTED_FAULTS:
                    return {"error": f"no fault {request['fault']!r}; use one of {', '.join(COUNTED_FAULTS)}"}
                self._firmware.feed(b"", now_s)
                self._firmware.trigger_fault(request["fault"], now_s)
            case Command.UNPLUG:
                self._pieces.clear()
                self._port.unplug()
            case Command.PLUG:
                self._port.unplug()
                self._port.plug()
            case other:
                return {"error": f"no command {other!r}; use one of {', '.join(Command)}"}
        return {"done": request["do"]}


def _open_control_socket(folder: Path) -> socket.socket:
    (folder / CONTROL_SOCKET).unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX)
    with shorten_path(folder) as short_path:
        listener.bind(f"{short_path}/{CONTROL_SOCKET}")
    (folder / CONTROL_SOCKET).chmod(0o600)
    listener.listen()
    return listener


def _take_lock(path: Path) -> IO[bytes]:
    lock = path.open("ab")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PortError(f"{path.parent}: an emulator is already running here; switch it off first") from None
    return lock


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line, and run the emulator until it is switched off."""
    parser = argparse.ArgumentParser(
        prog="python -m drivers.emulator", description="A simulated printer on a pty."
    )
    parser.add_argument("--model", required=True, choices=sorted(PROFILES))
    parser.add_argument("--folder", required=True, type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="farm seconds per wall second")
    parser.add_argument("--anchor", type=float, default=0.0, help="epoch seconds at which both clocks agree")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME[=VALUE]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--detach", action="store_true", help="continue in the background once the port exists"
    )
    options = parser.parse_args(arguments)
    try:
        faults = parse_faults(options.fault)
        options.folder.mkdir(parents=True, exist_ok=True)
        lock = _take_lock(options.folder / ALIVE_LOCK)
    except PortError as error:
        parser.error(str(error))
    with lock:
        if options.detach:
            ready_fd, done_fd = os.pipe()
            if os.fork() > 0:
                os.close(done_fd)
                return 0 if os.read(ready_fd, 1) else 1
            os.close(ready_fd)
        emulator = Emulator(
            PROFILES[options.model],
            faults,
            options.seed,
            options.folder,
            Clock(options.scale, options.anchor),
        )

        def power_off_on_signal(signum: int, frame: FrameType | None) -> None:
            emulator.switch_off()

        signal.signal(signal.SIGTERM, power_off_on_signal)
        signal.signal(signal.SIGINT, power_off_on_signal)
        if options.detach:
            os.write(done_fd, b"1")
            os.close(done_fd)
        emulator.run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
