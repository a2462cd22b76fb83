"""Printrun's printcore prints a file; runs in the environment of `make interop`.

``printcore_peer.py TTY GCODE``: prints the seconds from the first line of the file to the ok of the last.
"""

import sys
import time
from pathlib import Path

from printrun import gcoder
from printrun.printcore import printcore


def main():
    port, path = sys.argv[1:]
    lines = Path(path).read_text().splitlines()
    core = printcore()
    core.loud = False
    core.connect(port, 250000)
    while not core.online:
        time.sleep(0.01)
    time.sleep(1.0)
    began = time.monotonic()
    core.startprint(gcoder.LightGCode(lines))
    while core.printing:
        time.sleep(0.001)
    print(time.monotonic() - began, flush=True)
    core.send_now("M400")
    time.sleep(1.0)
    core.disconnect()


main()
