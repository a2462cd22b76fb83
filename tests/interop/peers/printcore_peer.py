"""Print a file with Printrun's printcore, in the environment of `make interop`.

``printcore_peer.py TTY GCODE [HEADER]`` writes the seconds from the first line of the file GCODE to the ok of
its last line. The file HEADER is printed before it.
"""

import sys
import time
from pathlib import Path

from printrun import gcoder
from printrun.printcore import printcore


def print_file(core, path):
    started_s = time.monotonic()
    core.startprint(gcoder.LightGCode(Path(path).read_text().splitlines()))
    while core.printing:
        time.sleep(0.001)
    return time.monotonic() - started_s


def main():
    port, path, *header_files = sys.argv[1:]
    core = printcore()
    core.loud = False
    core.connect(port, 250000)
    while not core.online:
        time.sleep(0.01)
    time.sleep(1.0)
    for header_file in header_files:
        print_file(core, header_file)
        time.sleep(0.5)
    print(print_file(core, path), flush=True)
    core.send_now("M400")
    time.sleep(1.0)
    core.disconnect()


main()
