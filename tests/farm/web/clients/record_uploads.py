"""Record the bytes of uploads by the libraries of slicers, libcurl and Qt.

``FARM_INTEROP=.venv/interop/bin/python .venv/bin/python tests/farm/web/clients/record_uploads.py`` writes
the files in `recorded/` again, after `make peers`. PrusaSlicer and its forks drive libcurl as here; Cura's
plugin for OctoPrint drives Qt as `tests/interop/peers/qt_peer.py` does.
"""

import os
import socket
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

TEST_FOLDER = Path(__file__).parent
TESTS = TEST_FOLDER.parents[2]
sys.path.insert(0, str(TESTS / "support"))

from model_files.make_gcode import make_marlin, make_square  # noqa: E402

FOLDER = TEST_FOLDER / "recorded"
KEY = f"farm_{'a' * 8}_{'A' * 43}"
PORT = 8467
ANSWER = b'{"done":true}'
FILE_FIELD = "file=@{path};filename={name};type=application/octet-stream"
PRUSA_OPTIONS, EXPECT_OPTIONS = ["-A", "PrusaSlicer/2.9.4"], ["-H", "Expect: 100-continue"]
LOCAL_PATH = "/api/files/local"
CURL_UPLOADS = {  # name -> (path, name of the file, options)
    "libcurl-print": (
        LOCAL_PATH,
        "part.gcode",
        [*PRUSA_OPTIONS, *EXPECT_OPTIONS, "-F", "print=true", "-F", "path=", "-F", FILE_FIELD],
    ),
    "libcurl-upload": (
        LOCAL_PATH,
        "part.gcode",
        [*PRUSA_OPTIONS, "-F", "print=false", "-F", "path=", "-F", FILE_FIELD],
    ),
    "libcurl-file-first": (
        LOCAL_PATH,
        "part.gcode",
        [*PRUSA_OPTIONS, "-F", FILE_FIELD, "-F", "path=", "-F", "print=true"],
    ),
    "libcurl-odd-name": (
        LOCAL_PATH,
        'Größe "2" (1).gcode',
        ["-F", "print=false", "-F", "path=a/b", "-F", FILE_FIELD],
    ),
    "libcurl-moonraker": (
        "/server/files/upload",
        "part.gcode",
        ["-F", "root=gcodes", "-F", "print=true", "-F", FILE_FIELD],
    ),
}
QT_UPLOADS = {
    "qt-print": ("part.gcode", ["select=true", "print=true"]),
    "qt-upload": ("part.gcode", []),
    "qt-odd-name": ("Größe 2 (1).gcode", []),
}


def receive_request(listener: socket.socket) -> bytes:
    """Receive one complete request, and answer it as OctoPrint does."""
    connection, _ = listener.accept()
    with connection:
        data = b""
        while b"\r\n\r\n" not in data:
            data += connection.recv(65536)
        head, _, _ = data.partition(b"\r\n\r\n")
        if b"100-continue" in head:
            connection.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
        (length,) = (line for line in head.lower().splitlines() if line.startswith(b"content-length:"))
        size = len(head) + 4 + int(length.partition(b":")[2])
        while len(data) < size:
            data += connection.recv(65536)
        head = b"HTTP/1.1 201 CREATED\r\nContent-Type: application/json\r\n"
        location = b"Location: http://farm/api/files/local/part.gcode\r\n"
        connection.sendall(head + location + b"Content-Length: %d\r\n\r\n" % len(ANSWER) + ANSWER)
        return data


def record_upload(name: str, command: list[str | Path]) -> None:
    """Run a client, and write the bytes that it sends."""
    with socket.create_server(("127.0.0.1", PORT)) as listener:
        received_parts: list[bytes] = []
        receiver = threading.Thread(
            target=lambda: received_parts.append(receive_request(listener)), daemon=True
        )
        receiver.start()
        subprocess.run(command, check=True, timeout=60, stdout=subprocess.DEVNULL)
        receiver.join(60)
    (FOLDER / f"{name}.http").write_bytes(received_parts[0])


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    url = f"http://127.0.0.1:{PORT}"
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "part.gcode"
        path.write_text("\n".join(make_marlin(make_square(layers=2))) + "\n")
        for name, (url_path, file_name, options) in CURL_UPLOADS.items():
            quoted_name = '"' + file_name.replace('"', '\\"') + '"'
            arguments = [
                option.format(path=path, name=quoted_name) if option is FILE_FIELD else option
                for option in options
            ]
            record_upload(name, ["curl", "-sS", "-H", f"X-Api-Key: {KEY}", *arguments, url + url_path])
        for name, (file_name, fields) in QT_UPLOADS.items():
            peer = [os.environ["FARM_INTEROP"], TESTS / "interop/peers/qt_peer.py"]
            record_upload(name, [*peer, url + LOCAL_PATH, KEY, path, file_name, *fields])


if __name__ == "__main__":
    main()
