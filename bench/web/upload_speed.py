"""Speed of uploads from the network, and the daemon's response times during them.

``python -m bench.web.upload_speed [--mb MB] [--times N] [--form] [--json]``. A real daemon runs with one
simulated printer. This process sends a file of MB megabytes over loopback TCP with a key: with `--form` as
slicers do (multipart), else as `farm submit` does. Another process requests `GET /status` on the Unix socket
and on TCP every 50 ms. The file is G-code that is refused because of its first line, so the answer comes as
soon as the last byte is on the disk. A further upload is cut off in the middle, and the files that it
leaves on the disk are counted.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import secrets
import socket
import sys
import tempfile
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx

from bench.web.farm import WebFarm
from farm.api import NETWORK_PREFIX

MB = 10**6
BLOCK = b"M999 ; a command that no file may have\n" + b"G1 X100.123 Y100.456 E0.12345\n" * 30_000
POLL_S = 0.05
TIMEOUT_S = 300.0
GOALS = {"mb_per_s": 100.0, "status_worst_ms": 100.0}
BOUNDARY = b"------------------------9b1418d19f570849"


def make_request(farm: WebFarm, key: str, size: int, form: bool) -> tuple[bytes, bytes, bytes]:
    """Return the headers of the request, and its bytes before and after the file."""
    bytes_before_file, bytes_after_file = b"", b""
    if form:
        path, media_type = "/api/files/local", b"multipart/form-data; boundary=" + BOUNDARY
        for name, value in ((b"print", b"false"), (b"path", b"")):
            bytes_before_file += b'--%b\r\nContent-Disposition: form-data; name="%b"\r\n\r\n%b\r\n' % (
                BOUNDARY,
                name,
                value,
            )
        bytes_before_file += (
            b'--%b\r\nContent-Disposition: form-data; name="file"; filename="big.gcode"\r\n' % BOUNDARY
        )
        bytes_before_file += b"Content-Type: application/octet-stream\r\n\r\n"
        bytes_after_file = b"\r\n--%b--\r\n" % BOUNDARY
    else:
        path = f"{NETWORK_PREFIX}/jobs?request_id={secrets.token_hex(8)}&name=big.gcode&size={size}"
        media_type = b"application/octet-stream"
    length = len(bytes_before_file) + size + len(bytes_after_file)
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nX-Api-Key: {key}\r\nContent-Length: {length}\r\n"
    return (
        head.encode() + b"Connection: close\r\nContent-Type: %b\r\n\r\n" % media_type,
        bytes_before_file,
        bytes_after_file,
    )


def upload(farm: WebFarm, key: str, size: int, form: bool, share: float = 1.0) -> tuple[float, int, str]:
    """Upload a file, or the first `share` of it.

    Returns
    -------
    seconds, status, text
        Seconds from the first byte to the answer, HTTP status, and text of the answer; an upload that is cut
        off has the status 0 and no text.
    """
    head, bytes_before_file, bytes_after_file = make_request(farm, key, size, form)
    with socket.create_connection(("127.0.0.1", farm.port), TIMEOUT_S) as connection:
        start_s = time.perf_counter()
        connection.sendall(head + bytes_before_file)
        remaining_bytes = int(size * share)
        while remaining_bytes:
            block = memoryview(BLOCK)[:remaining_bytes]
            connection.sendall(block)
            remaining_bytes -= len(block)
        if share < 1.0:
            return time.perf_counter() - start_s, 0, ""
        connection.sendall(bytes_after_file)
        answer = b""
        while chunk := connection.recv(65536):
            answer += chunk
        duration_s = time.perf_counter() - start_s
    status, _, text = answer.partition(b"\r\n\r\n")
    return duration_s, int(status.split()[1]), text.decode()


def request_status(state: Path, port: int, key: str, pipe: Connection) -> None:
    """Request the status until a message stops it; send the milliseconds of each answer."""
    durations_ms: list[float] = []
    socket_transport = httpx.HTTPTransport(uds=str(state / "farm.sock"))
    with (
        httpx.Client(transport=socket_transport, base_url="http://farm", timeout=TIMEOUT_S) as local_client,
        httpx.Client(
            base_url=f"http://127.0.0.1:{port}", headers={"x-api-key": key}, timeout=TIMEOUT_S
        ) as network_client,
    ):
        while not pipe.poll():
            for client, path in ((local_client, "/status"), (network_client, f"{NETWORK_PREFIX}/status")):
                start_s = time.perf_counter()
                client.get(path).raise_for_status()
                durations_ms.append(1000 * (time.perf_counter() - start_s))
            time.sleep(POLL_S)
    pipe.send(durations_ms)


def measure_response_times(farm: WebFarm, key: str) -> Iterator[list[float]]:
    """Request the status in another process; yield an empty list, then the response times in ms."""
    receiver, sender = multiprocessing.get_context("spawn").Pipe()
    requester = multiprocessing.get_context("spawn").Process(
        target=request_status, args=(farm.state, farm.port, key, sender)
    )
    requester.start()
    yield []
    receiver.send(None)
    durations_ms = receiver.recv()
    requester.join()
    yield durations_ms


def measure(size_mb: int, times: int, form: bool) -> dict[str, Any]:
    """Measure the speed of uploads, response times during them, and the files that a cut upload leaves."""
    with tempfile.TemporaryDirectory() as name:
        farm = WebFarm(Path(name))
        try:
            key = farm.add_key("bench", "print")
            size, durations_s = size_mb * MB, []
            upload(farm, key, MB, form)  # the first upload waits for the workers
            idle_times = measure_response_times(farm, key)
            next(idle_times)
            time.sleep(3.0)
            idle_ms = sorted(next(idle_times))
            start_cpu_s, busy_times = farm.read_cpu_s(), measure_response_times(farm, key)
            next(busy_times)
            time.sleep(2.0)  # the process sends its first request meanwhile
            for _ in range(times):
                seconds, status, text = upload(farm, key, size, form)
                if status != 400 or "line 1" not in text:
                    raise RuntimeError(f"unexpected answer {status}: {text}")
                durations_s.append(seconds)
            status_ms = sorted(next(busy_times))
            cpu_s = farm.read_cpu_s() - start_cpu_s
            upload(farm, key, size, form, share=0.5)
            time.sleep(1.0)
            left_files = farm.list_work_files()
        finally:
            farm.run("down", "--now")
    return {
        "mb": size_mb,
        "form": form,
        "mb_per_s": max(size_mb / seconds for seconds in durations_s),
        "mb_per_s_each": [size_mb / seconds for seconds in durations_s],
        "cpu_s_per_gb": 1000 * cpu_s / (size_mb * times),
        "status_requests": len(status_ms),
        "status_median_ms": status_ms[len(status_ms) // 2],
        "status_p99_ms": status_ms[int(0.99 * len(status_ms))],
        "status_worst_ms": status_ms[-1],
        "idle_status_median_ms": idle_ms[len(idle_ms) // 2],
        "idle_status_worst_ms": idle_ms[-1],
        "files_of_cut_upload": left_files,
        "load": os.getloadavg()[0],
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mb", type=int, default=500)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--form", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(args.mb, args.times, args.form)
    if args.json:
        print(json.dumps({**result, "goals": GOALS}, indent=2))
    else:
        print(
            f"{result['mb']} MB: {result['mb_per_s']:.0f} MB/s; GET /status meanwhile took "
            f"{result['status_median_ms']:.0f} ms (median), {result['status_worst_ms']:.0f} ms at worst; "
            f"an interrupted upload leaves {len(result['files_of_cut_upload'])} files"
        )
    is_goal_missed = (
        result["mb_per_s"] < GOALS["mb_per_s"] or result["status_worst_ms"] > GOALS["status_worst_ms"]
    )
    sys.exit(is_goal_missed or bool(result["files_of_cut_upload"]))


if __name__ == "__main__":
    main()
