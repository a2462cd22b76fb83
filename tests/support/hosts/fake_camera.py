"""A camera on a port of this host, with valid or hostile answers."""

import struct
import threading
import zlib
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


def make_jpeg(width=640, height=480, tail=b"picture"):
    """Make the beginning of a JPEG of this size: an application segment and a frame header, then `tail`."""
    application = b"\xff\xe0" + struct.pack(">H", 16) + b"JFIF\0" + bytes(9)
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 17, 8, height, width, 3) + bytes(9)
    return b"\xff\xd8" + application + frame + b"\xff\xda" + tail


def make_png(width=2, height=2):
    """Make a PNG with this size in its header; only a small one contains image data."""

    def make_chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = b"".join(b"\0" + bytes(width) for _ in range(height if height < 100 else 0))
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = [make_chunk(b"IHDR", header), make_chunk(b"IDAT", zlib.compress(rows)), make_chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


class FakeCamera(ThreadingHTTPServer):
    """HTTP server that records each request and answers it by calling a function.

    Attributes
    ----------
    answer
        Function that answers a request; its argument is the handler of the request.
    requests
        Path and headers of each request.
    stopped
        Event that is set when the server ends; slow answers wait for it.
    """

    daemon_threads = True

    def __init__(self, answer):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.answer, self.requests, self.stopped = answer, [], threading.Event()

    @property
    def address(self):
        return f"127.0.0.1:{self.server_port}"

    def handle_error(self, request, client_address):
        """Ignore the error, because the farm disconnects from hostile cameras."""


class _Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        headers = {name.lower(): value for name, value in self.headers.items()}
        self.server.requests.append((self.path, headers))
        self.server.answer(self)

    def send(self, body, status=200, **headers):
        self.send_response(status)
        for name, value in {"content-length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@contextmanager
def run_camera(answer):
    """Run a camera until the block ends."""
    camera = FakeCamera(answer)
    thread = threading.Thread(target=camera.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield camera
    finally:
        camera.stopped.set()
        camera.shutdown()
        camera.server_close()
        thread.join()
