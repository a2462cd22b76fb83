"""OctoPrint's virtual printer behind a pseudo-terminal; runs in the environment of `make interop`.

``octoprint_peer.py FOLDER FIRMWARE FAULT@LINE...`` prints the path of the terminal's slave, and serves it
until it is closed. With the LINE-th G-code command, the virtual printer executes its own debug command FAULT.
The executed commands are written to FOLDER/done.txt, one on each line.
"""

import os
import pty
import sys
import threading
import tty
from pathlib import Path

from octoprint.plugins import virtual_printer
from octoprint.plugins.virtual_printer import virtual

MARLIN2 = {
    "firmwareName": "Marlin 2.0.9.1",
    "m115FormatString": "FIRMWARE_NAME:{firmware_name} MACHINE_TYPE:Ender-3 EXTRUDER_COUNT:1",
    "sendBusy": True,
    "busyInterval": 1.0,
    "okFormatString": "ok N{lastN} P{buffer} B{buffer}",
    "okAfterResend": True,
    "resetLines": ["start", "echo:Marlin 2.0.9.1", "echo:SD card ok"],
    "errors": {
        "checksum_mismatch": "checksum mismatch, Last Line: {lastN}",
        "checksum_missing": "No Checksum with line number, Last Line: {lastN}",
        "lineno_mismatch": "Line Number is not Last Line Number+1, Last Line: {lastN}",
    },
}


class Settings:
    """Default settings of the plugin; for Marlin 2, with the texts of the real firmware."""

    def __init__(self, folder, firmware):
        self._folder = folder
        self._values = virtual_printer.VirtualPrinterPlugin().get_settings_defaults()
        if firmware == "marlin2":
            errors = self._values["errors"]
            self._values.update(MARLIN2)
            self._values["errors"] = {**errors, **MARLIN2["errors"]}

    def get(self, path, merged=False):
        value = self._values
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    get_int = get_float = get_boolean = get

    def global_get_basefolder(self, name):
        return str(self._folder)


class Hooks:
    """Plugin manager without hooks."""

    def get_hooks(self, name):
        return {}


class Printer(virtual.VirtualPrinter):
    """Virtual printer that records executed commands and simulates faults at given lines.

    Two kinds of fault acknowledge a line and discard it, which no host can detect: the simulated error
    `resend_with_timeout`, which happens once, and each line that `resend_ratio` selects. Discarded lines are
    listed in FOLDER/dropped.txt.
    """

    def __init__(self, folder, firmware, faults):
        self.is_marlin2 = firmware == "marlin2"
        self.done_file = (folder / "done.txt").open("w", buffering=1)
        self.dropped_file = (folder / "dropped.txt").open("w", buffering=1)
        self.dropped_file.write("resend_with_timeout\n")
        self.command_count = 0
        self.faults = faults
        super().__init__(Settings(folder, firmware), None, str(folder), read_timeout=0.2)

    def _triggerResend(self, expected=None, actual=None, checksum=None):
        if actual is None and not checksum and expected == self.current_line + 1:
            # This is the query of our link, which the real firmware answers in this way.
            if self.is_marlin2:
                self._send(f"Error:No Checksum with line number, Last Line: {self.lastN}")
                self._send(f"Resend: {self.lastN + 1}")
                self._send("ok")
            else:
                self._send(f"Error:No Line Number with checksum, Last Line: {self.lastN}")
            return
        if self._resend_every_n and checksum:
            self.dropped_file.write("resend_ratio\n")
        super()._triggerResend(expected, actual, checksum)

    def _error(self, error, *args, **kwargs):
        if not self.is_marlin2:
            return super()._error(error, *args, **kwargs)
        return f"Error:{self._errors.get(error).format(*args, **{'lastN': self.lastN, **kwargs})}"

    def _gcode_M503(self, data):
        if self.is_marlin2:
            self._send("echo:Home offset:")
            self._send("echo:  M206 X0.00 Y0.00 Z0.00")
        else:
            super()._gcode_M503(data)

    def _gcode_G(self, code, data):
        self.command_count += 1
        self.done_file.write(data.partition("*")[0].strip() + "\n")
        for fault in self.faults.pop(self.command_count, ()):
            self._debugTrigger(fault)


def main():
    folder = Path(sys.argv[1])
    faults = {}
    firmware = sys.argv[2]
    for argument in sys.argv[3:]:
        fault, _, line = argument.rpartition("@")
        faults.setdefault(int(line), []).append(fault)
    virtual.plugin_manager = lambda: Hooks()
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    sys.stdin.readline()  # wait until the host has opened the port
    os.close(slave)
    printer = Printer(folder, firmware, faults)

    def answer_lines():
        try:
            while True:
                line = printer.readline()
                if line:
                    os.write(master, line if line.endswith(b"\n") else line + b"\n")
        except Exception:
            os.close(master)

    threading.Thread(target=answer_lines, daemon=True).start()
    try:
        while data := os.read(master, 256):
            if firmware == "marlin2":  # Marlin 2 refuses a line without a checksum
                data = data.replace(b"N0 M110\n", b"N0 M110*0\n")
            for line in data.splitlines(keepends=True):  # the virtual printer accepts one line at a time
                while line:
                    line = line[printer.write(line) :]
    except Exception:
        pass
    printer.close()
    os._exit(0)


main()
