"""A farm on the network to which slicers send files."""

import asyncio
from types import SimpleNamespace

from clusters.same_process import AcceptingWorkers
from farm.errors import ErrorCode, FarmError
from farms.web_farm import HOST, WebFarm

UPLOAD_PATH = "/api/files/local"
CONTENT = b"G28\n" * 1000


class RefusingWorkers(AcceptingWorkers):
    """Workers that refuse every file."""

    async def run(self, work, path, name, *args, limit=None):
        raise FarmError(f"{name}: line 12: G29 probes the bed, which this printer cannot", ErrorCode.GCODE)


class SlicerFarm(WebFarm):
    """Farm with printers `a` and `b`, and methods that send it requests as slicers do."""

    @property
    def jobs_by_number(self):
        """Jobs by their numbers."""
        return self.controller.books.jobs

    @property
    def unfinished_uploads(self):
        """Names of the files in the folder of unfinished uploads."""
        return sorted(path.name for path in self.state.work.iterdir())

    def upload(self, key, name="box.gcode", url_path=UPLOAD_PATH, content=CONTENT, **fields):
        """Send a file in a form."""
        return self.ask("POST", url_path, key, files={"file": (name, content)}, data=fields)

    def send(self, path, key, chunks, headers):
        """Send a body in chunks; None closes the connection. Return status, text and the unread count."""
        sent_messages = []
        messages = [
            {"type": "http.disconnect"}
            if chunk is None
            else {"type": "http.request", "body": chunk, "more_body": number + 1 < len(chunks)}
            for number, chunk in enumerate(chunks)
        ]

        async def receive():
            return messages.pop(0)

        async def send(message):
            sent_messages.append(message)

        all_headers = {"host": HOST, "x-api-key": key.text, **headers}
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": "POST",
            "scheme": "http",
            "path": path,
            "raw_path": path.encode(),
            "query_string": b"",
            "root_path": "",
            "headers": [(name.encode(), value.encode()) for name, value in all_headers.items()],
            "client": ("10.0.0.9", 1),
            "server": (HOST, 80),
        }
        asyncio.run(self.web(scope, receive, send))
        body = b"".join(message.get("body", b"") for message in sent_messages)
        return SimpleNamespace(status=sent_messages[0]["status"], text=body.decode(), unread=len(messages))
