"""OctoPrint's virtual printer behind a pseudo-terminal; runs in the environment of `make interop`.

``octoprint_peer.py FOLDER FAULT@LINE...``: prints the slave's path, then serves until its end is closed.
At its LINE-th G-code the printer's own debug command FAULT is given. What it carried out is in
FOLDER/done.txt, one command a line.
"""

import os
import pty
import sys
import threading
import tty
from pathlib import Path

from octoprint.plugins import virtual_printer
from octoprint.plugins.virtual_printer import virtual


class Settings:
    """The plugin's defaults, with the reset's lines and the oks of a real Marlin."""

    def __init__(self, folder):
        self._folder = folder
        self._values = virtual_printer.VirtualPrinterPlugin().get_settings_defaults()

    def get(self, path, merged=False):
        value = self._values
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        return value

    get_int = get_float = get_boolean = get

    def global_get_basefolder(self, name):
        return str(self._folder)


class Hooks:
    def get_hooks(self, name):
        return {}


class Printer(virtual.VirtualPrinter):
    """Writes down what it carries out, and gets its faults in time.

    Two of its faults take a line for received that they throw away, which no host can know: its simulated
    error `resend_with_timeout` (once), and each one that `resend_ratio` draws. They are counted.
    """

    def __init__(self, folder, faults):
        self.done = (folder / "done.txt").open("w", buffering=1)
        self.dropped = (folder / "dropped.txt").open("w", buffering=1)
        self.dropped.write("resend_with_timeout\n")
        self.count = 0
        self.faults = faults
        super().__init__(Settings(folder), None, str(folder), read_timeout=0.2)

    def _triggerResend(self, expected=None, actual=None, checksum=None):
        if actual is None and not checksum and expected == self.current_line + 1:
            # Our question, a checksum without a number; the printer's firmware answers it so.
            self._send(f"Error:No Line Number with checksum, Last Line: {self.lastN}")
            return
        if self._resend_every_n and checksum:
            self.dropped.write("resend_ratio\n")
        super()._triggerResend(expected, actual, checksum)

    def _gcode_G(self, code, data):
        self.count += 1
        self.done.write(data.partition("*")[0].strip() + "\n")
        for fault in self.faults.pop(self.count, ()):
            self._debugTrigger(fault)


def main():
    folder = Path(sys.argv[1])
    faults = {}
    for word in sys.argv[2:]:
        fault, _, line = word.rpartition("@")
        faults.setdefault(int(line), []).append(fault)
    virtual.plugin_manager = lambda: Hooks()
    master, slave = pty.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    sys.stdin.readline()  # the host has it open
    os.close(slave)
    printer = Printer(folder, faults)

    def talk():
        try:
            while True:
                line = printer.readline()
                if line:
                    os.write(master, line if line.endswith(b"\n") else line + b"\n")
        except Exception:
            os.close(master)

    threading.Thread(target=talk, daemon=True).start()
    try:
        while data := os.read(master, 256):
            for line in data.splitlines(keepends=True):  # it takes one line of what is written at a time
                while line:
                    line = line[printer.write(line) :]
    except Exception:
        pass
    printer.close()
    os._exit(0)


main()
