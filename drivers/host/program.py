"""`farm host`, which the daemon runs over ssh: it connects stdin and stdout with this host's service.

The first line on stdin is a `HostRequest`, or a `BridgeRequest`, which is executed as by the bridge. The
service outlives the connection.
"""

from __future__ import annotations

import os
import select
import socket
import sys
from concurrent.futures import ThreadPoolExecutor, as_completed

from drivers.errors import AgentError, DriverError
from drivers.host.messages import HostRequest, HostTask, is_for_host
from drivers.host.paths import HostPaths, connect_to_service
from drivers.records import StartFile
from drivers.remote import bridge
from drivers.safety import StopResult, StopTarget, stop_printer

_READ_BYTES = 65536


def serve_stdio() -> int:
    """Read the request in the first line and execute it; return the exit code."""
    line = bridge.read_first_line()
    if not line:
        return 2
    if not is_for_host(line):
        return bridge.execute(line)
    try:
        request = HostRequest.parse(line)
        paths = HostPaths(request.farm)
        if request.do is HostTask.STOP:
            _stop_printers(request, paths)
        else:
            with connect_to_service(paths) as service:
                service.sendall(line)
                _copy_bytes(service)
    except BrokenPipeError:
        return 0
    except (DriverError, OSError) as error:
        print(f"farm: {error}", file=sys.stderr)  # noqa: T201 - the daemon logs it
        return 1
    return 0


def _copy_bytes(service: socket.socket) -> None:
    """Copy bytes until one end closes. A slow end stops only its own direction."""
    target_by_source = {0: service.fileno(), service.fileno(): 1}
    unwritten = {0: b"", service.fileno(): b""}  # bytes that were read, but not written yet, by their source
    for descriptor in (1, service.fileno()):
        os.set_blocking(descriptor, False)
    while True:
        readers = [source for source, data in unwritten.items() if not data]
        writers = {target_by_source[source]: source for source, data in unwritten.items() if data}
        readable, writable, _ = select.select(readers, list(writers), [])
        for source in readable:
            data = os.read(source, _READ_BYTES)
            if not data:
                return
            unwritten[source] = data
        for target in writable:
            source = writers[target]
            unwritten[source] = unwritten[source][os.write(target, unwritten[source]) :]


def _stop_printers(request: HostRequest, paths: HostPaths) -> None:
    """Stop printers in parallel; write each result as a line of JSON as soon as it is known."""
    with ThreadPoolExecutor(max_workers=max(1, len(request.starts))) as pool:
        for stop in as_completed([pool.submit(_stop_printer, start, paths) for start in request.starts]):
            sys.stdout.write(stop.result().dump() + "\n")
            sys.stdout.flush()


def _stop_printer(start: StartFile, paths: HostPaths) -> StopResult:
    try:
        return stop_printer(StopTarget.from_agent(start, paths.find_agent_folder(start.printer)))
    except (AgentError, OSError) as error:
        return StopResult(start.printer, None, False, f"cannot be stopped ({error}); switch the printer off")
