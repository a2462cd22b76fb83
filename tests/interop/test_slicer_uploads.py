"""Clients of other projects send G-code to a real daemon, whose simulated printer prints it.

G-code of PrusaSlicer is sent by curl, with the options that PrusaSlicer sets in libcurl. Qt sends files as
Cura's plugin for OctoPrint does. OctoRest is a client of OctoPrint in Python.
"""

import json
import os
import shutil
import socket
import subprocess
from pathlib import Path

import pytest
import trimesh

from farms.real_farm import TIME_LIMIT_S, RealFarm, wait_for
from model_files.make_gcode import make_marlin, make_square

PEERS = Path(__file__).parent / "peers"
PYTHON = Path(os.environ.get("FARM_INTEROP", "none"))
END_STATES = ("printed", "done")
pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not PYTHON.exists(), reason="the peers are missing: make interop"),
]


needs_curl = pytest.mark.skipif(shutil.which("curl") is None, reason="curl is missing: apt install curl")


@pytest.fixture(scope="module")
def qt():
    """Skip the test if system libraries of Qt are missing, as on a server without a desktop."""
    result = subprocess.run(
        [PYTHON, "-c", "import PySide6.QtNetwork"], capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        pytest.skip(f"Qt cannot be loaded: {result.stderr.strip().rpartition(chr(10))[2]}")


class ServedFarm(RealFarm):
    """Farm with two simulated printers, a port for the network, and a key."""

    def __init__(self, folder):
        super().__init__(folder, dict.fromkeys(("a", "b"), ("ultimaker2_plus", "sim://ultimaker2_plus")))
        with socket.create_server(("127.0.0.1", 0)) as probe:
            port = probe.getsockname()[1]
        self.url = f"http://127.0.0.1:{port}"
        with self.fleet.open("a") as file:
            file.write(f"web: {{listen: '127.0.0.1:{port}'}}\n")
        self.up()
        self.key = self.run_checked("key", "add", "slicer", "--role", "print").strip()

    def wait_until_printed(self, job):
        """Wait until a job is printed, clear the bed, and return the name of the printer."""
        wait_for(f"job {job}", lambda: self.read_job(job)["state"] in END_STATES)
        (plate,) = self.read_job(job)["plates"]
        self.run_checked("cleared", plate["printer"])
        return plate["printer"]


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    farm = ServedFarm(tmp_path_factory.mktemp("farm"))
    yield farm
    farm.end()


@pytest.fixture(scope="module")
def tower(tmp_path_factory):
    """Return the path of G-code for a small tower."""
    path = tmp_path_factory.mktemp("tower") / "tower.gcode"
    path.write_text("\n".join(make_marlin(make_square(layers=2))) + "\n")
    return path


def send_with_curl(farm, path, url_path="", **fields):
    """Send a file as PrusaSlicer does; return the status, the content type and the body."""
    form = [argument for name, value in fields.items() for argument in ("-F", f"{name}={value}")]
    command = ["curl", "-sS", "-A", "PrusaSlicer/2.9.4", "-H", f"X-Api-Key: {farm.key}", *form, "-F", "path="]
    command += ["-F", f"file=@{path};type=application/octet-stream", f"{farm.url}{url_path}/api/files/local"]
    answer = subprocess.run(
        [*command, "-w", "\n%{http_code} %{content_type}"],
        check=True,
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT_S,
    ).stdout
    body, _, status_line = answer.rpartition("\n")
    status, _, content_type = status_line.partition(" ")
    return int(status), content_type, body


def send_with_qt(farm, path, *fields, url_path=""):
    url = f"{farm.url}{url_path}/api/files/local"
    command = [PYTHON, PEERS / "qt_peer.py", url, farm.key, path, path.name, *fields]
    return json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=TIME_LIMIT_S).stdout
    )


@needs_curl
def test_gcode_of_prusaslicer_is_printed_by_the_printer_in_the_url(farm, slice_box):
    gcode_path = slice_box("sent")
    status, _, body = send_with_curl(farm, gcode_path, "/to/b", print="true")
    assert status == 201, body
    job = farm.read_job(int(json.loads(body)["files"]["local"]["path"].partition("/")[0]))
    assert (job["name"], job["submitted_by"]) == ("sent.gcode", "key slicer")
    assert farm.wait_until_printed(job["id"]) == "b"


@needs_curl
def test_refusal_for_prusaslicer_is_plain_text_that_names_the_line(farm, slice_box):
    gcode_path = slice_box("hot", "--temperature", "290")
    status, content_type, body = send_with_curl(farm, gcode_path, print="true")
    assert (status, content_type) == (400, "text/plain")
    assert body.startswith("line ") and "M104 sets 290 C, but the limit of the nozzle is 260 C" in body[:100]


@needs_curl
def test_large_model_is_accepted_from_curl_that_waits_for_100_continue(farm, tmp_path):
    model = tmp_path / "ball.stl"
    trimesh.creation.icosphere(subdivisions=6, radius=10.0).export(model)
    assert model.stat().st_size > 2**20  # for larger files, libcurl waits for `100 Continue`
    status, _, body = send_with_curl(farm, model, print="false")
    assert status == 201, body
    assert json.loads(body)["effectivePrint"] is False


@pytest.mark.parametrize("fields", [(), ("select=true", "print=true")], ids=["upload", "print"])
def test_upload_by_qt_creates_a_job_at_the_location_that_cura_reads(farm, qt, tower, fields):
    answer = send_with_qt(farm, tower, *fields)
    assert answer["status"] == 201, answer
    location = answer["headers"]["location"]
    assert location.startswith(f"{farm.url}/api/files/local/") and location.endswith("/tower.gcode")
    number = int(location.split("/")[-2])
    if fields:
        farm.wait_until_printed(number)
    else:
        assert farm.read_job(number)["options"]["hold"]


def test_refusal_for_qt_is_plain_text(farm, qt, tmp_path):
    path = tmp_path / "hot.gcode"
    path.write_text("\n".join(make_marlin()).replace("M109 S205", "M109 S999") + "\n")
    answer = send_with_qt(farm, path, "print=true")
    assert (answer["status"], answer["headers"]["content-type"]) == (400, "text/plain")
    assert answer["body"].startswith("line 5: M109 sets 999 C")


def test_octorest_uploads_selects_and_follows_a_print(farm, tower):
    command = [PYTHON, PEERS / "octorest_peer.py", farm.url, farm.key, tower]
    answer = json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=TIME_LIMIT_S).stdout
    )
    assert answer["version"]["text"].startswith("OctoPrint")
    number = int(answer["upload"]["files"]["local"]["path"].partition("/")[0])
    assert answer["held"]["name"] == "tower.gcode"
    assert answer["printer"]["state"]["flags"]["operational"] is True
    assert "404" in answer["refusal"]
    farm.wait_until_printed(number)
