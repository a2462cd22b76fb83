"""Stand-in for ssh to hosts of `host_services`: ``ssh_pipe.py ADDRESSES -- HOST COMMAND``.

It copies bytes between stdin, stdout and the address of the host in the JSON file ADDRESSES. It imports few
modules, because one such process runs for each host of the daemon.
"""

import json
import os
import select
import socket
import sys

_CONNECT_S = 10.0
_READ_BYTES = 65536


def main() -> int:
    """Copy bytes until one end closes."""
    with open(sys.argv[1]) as file:  # noqa: PTH123 - pathlib takes longer to import than the rest
        address, port = json.load(file)[sys.argv[3]]
    with open(sys.argv[1] + ".pids", "a") as file:  # noqa: PTH123
        file.write(f"{os.getpid()}\n")
    try:
        connection = socket.create_connection((address, port), _CONNECT_S)
    except OSError as error:
        sys.stderr.write(f"ssh: {sys.argv[3]}: {error}\n")
        return 255
    connection.settimeout(None)
    targets = {0: connection.fileno(), connection.fileno(): 1}
    while True:
        for source in select.select([*targets], [], [])[0]:
            data = os.read(source, _READ_BYTES)
            if not data:
                return 0
            while data:
                data = data[os.write(targets[source], data) :]


if __name__ == "__main__":
    sys.exit(main())
