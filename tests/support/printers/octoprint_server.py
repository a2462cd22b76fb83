"""OctoPrint's own server, with its virtual printer, on a port of this host."""

import json
import os
import socket
import subprocess
import time
from pathlib import Path

import httpx

KEY = "0123456789ABCDEF0123456789ABCDEF"
TIME_LIMIT_S = 120.0
CONFIGURATION = {  # written as JSON, which OctoPrint reads because JSON is valid YAML
    "server": {
        "firstRun": False,
        "onlineCheck": {"enabled": False},
        "pluginBlacklist": {"enabled": False},
    },
    "api": {"key": KEY},
    "plugins": {
        "_disabled": [
            *("announcements", "backup", "discovery", "errortracking", "file_check", "firmware_check"),
            *("health_check", "pi_support", "softwareupdate", "tracking"),
        ],
        "virtual_printer": {"enabled": True},
    },
    "serial": {"port": "VIRTUAL", "autoconnect": True},
}


class OctoPrintServer:
    """OctoPrint in a folder, connected to its virtual printer.

    Parameters
    ----------
    folder
        Folder for its settings and files.
    """

    def __init__(self, folder):
        program = Path(os.environ["FARM_INTEROP"]).with_name("octoprint")
        (folder / "config.yaml").write_text(json.dumps(CONFIGURATION))
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        command = ["serve", "--iknowwhatimdoing", "--basedir", folder, "--host", "127.0.0.1"]
        with (folder / "server.log").open("wb") as log:
            self._process = subprocess.Popen(
                [program, *command, "--port", str(self.port)], stdout=log, stderr=subprocess.STDOUT
            )
        self._client = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=60)
        try:
            self._wait_until_connected(folder)
        except BaseException:
            self.close()
            raise

    def ask(self, method, path, key=KEY, **options):
        """Send a request with a key, and return its response."""
        return self._client.request(method, path, headers={"x-api-key": key} if key else {}, **options)

    def close(self):
        """End OctoPrint."""
        self._client.close()
        self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _wait_until_connected(self, folder):
        """Wait until OctoPrint answers and its printer is connected."""
        deadline_s = time.monotonic() + TIME_LIMIT_S
        while time.monotonic() < deadline_s and self._process.poll() is None:
            try:
                answer = self.ask("GET", "/api/printer")
                if answer.status_code == 200 and answer.json()["temperature"]:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.2)
        raise AssertionError((folder / "server.log").read_text()[-2000:])
