"""The same requests to OctoPrint and to the farm: status, keys and types of the answers, and `Location`.

Every key of the farm is one of OctoPrint with the same type, and no key that clients read is missing.
"""

import os
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from clusters.same_process import SameProcess
from farm.model import Role
from farms.web_farm import WebFarm
from model_files.make_gcode import make_marlin
from printers.octoprint_server import OctoPrintServer

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not Path(os.environ.get("FARM_INTEROP", "none")).exists(), reason="make interop"),
]
GCODE = "\n".join(make_marlin()).encode() + b"\n"
UPLOAD = "/api/files/local"
PRINTER_PATH = "/to/a"  # address of a printer of the farm; OctoPrint has only one
FLAGS = ("error", "closedOrError", "paused", "pausing", "printing", "cancelling", "ready", "operational")
FORM = ["done", "effectivePrint", "effectiveSelect", "files.local.name", "files.local.origin"]
FORM += ["files.local.path", "files.local.refs.resource"]


def make_upload(*fields, name="part.gcode", content=GCODE):
    """Make a form with fields and a file, in the order given; None stands for the file."""
    file = ("file", (name, content, "application/octet-stream"))
    return {"files": [file if field is None else (field[0], (None, field[1])) for field in fields]}


ANSWERS = {  # title -> (method, path, body), keys that clients read
    "version": (("GET", "/api/version", {}), ["api", "server", "text"]),
    "settings": (("GET", "/api/settings", {}), ["feature.sdSupport", "plugins", "webcam"]),
    "printer": (("GET", "/api/printer", {}), [*(f"state.flags.{flag}" for flag in FLAGS), "state.text"]),
    "printer of an address": (
        ("GET", f"{PRINTER_PATH}/api/printer", {}),
        [f"temperature.{heater}.{word}" for heater in ("tool0", "bed") for word in ("actual", "target")],
    ),
    "job": (
        ("GET", "/api/job", {}),
        ["job.file.name", "progress.completion", "progress.printTime", "progress.printTimeLeft", "state"],
    ),
    "profiles": (
        ("GET", "/api/printerprofiles", {}),
        [
            *(f"profiles.*.{key}" for key in ("id", "name", "model", "current")),
            *(f"profiles.*.axes.{axis}.{key}" for axis in "xyze" for key in ("speed", "inverted")),
        ],
    ),
    "login": (("POST", "/api/login", {"json": {"passive": True}}), ["name"]),
    "connection": (("GET", "/api/connection", {}), ["current.state"]),
    "user": (("GET", "/api/currentuser", {}), ["name"]),
    "server": (("GET", "/api/server", {}), ["version"]),
    "files": (("GET", "/api/files", {}), ["files"]),
    "files of local": (("GET", UPLOAD, {}), ["files"]),
    "upload": (("POST", UPLOAD, make_upload(("print", "false"), ("path", ""), None)), FORM),
    "upload, file first": (("POST", UPLOAD, make_upload(("path", ""), None, ("select", "true"))), FORM),
    "upload and print": (("POST", UPLOAD, make_upload(("print", "true"), ("path", ""), None)), FORM),
    "probe for app keys": (("GET", "/plugin/appkeys/probe", {}), []),
    "request of an app key": (("POST", "/plugin/appkeys/request", {"json": {"app": "Cura"}}), ["app_token"]),
}
REFUSALS = {  # title -> (method, path, body), status of the farm if it differs
    "no file": (("POST", UPLOAD, make_upload(("print", "false"))), None),
    "file that is not G-code": (("POST", UPLOAD, make_upload(None, name="a.txt")), 400),
    "unknown storage": (("POST", "/api/files/nowhere", make_upload(None)), None),
    "select an unknown file": (("POST", f"{UPLOAD}/none.gcode", {"json": {"command": "select"}}), None),
    "unknown address": (("GET", "/api/nothing", {}), None),
    "no key": (("GET", "/api/version", {"key": None}), 401),  # OctoPrint has guests with fewer rights
    "wrong key": (("GET", "/api/version", {"key": "nonsense"}), 401),
}


@pytest.fixture(scope="module")
def octoprint(tmp_path_factory):
    server = OctoPrintServer(tmp_path_factory.mktemp("octoprint"))
    server.ask("POST", UPLOAD, **make_upload(("select", "true"), None)).raise_for_status()
    yield server
    server.close()


class FarmAnswers:
    """Farm that answers requests of OctoPrint clients."""

    def __init__(self, folder):
        self.farm = WebFarm(folder, workers=SameProcess())
        self.farm.report_ready("a", nozzle_c=25.0, bed_c=24.0, nozzle_target_c=0.0, bed_target_c=0.0)
        self._key = self.farm.add_key(Role.PRINT)

    def ask(self, method, path, key="", **options):
        sent_key = self._key if key == "" else key and SimpleNamespace(text=key)
        return self.farm.ask(method, path, sent_key, **options)


@pytest.fixture
def farm_answers(tmp_path):
    return FarmAnswers(tmp_path)


def list_types(value, at=""):
    """Return the type of each value in JSON by its path, in which `*` stands for the name of a profile."""
    if isinstance(value, dict):
        names = {f"{at}.{'*' if at == '.profiles' else key}": inner for key, inner in value.items()}
        inner = {
            path: kind for name, inner in names.items() for path, kind in list_types(inner, name).items()
        }
        return {at.lstrip("."): "dict", **inner}
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return {at.lstrip("."): "number" if number else type(value).__name__}


def compare_answers(answer, reference, required_keys):
    """Compare the keys of two answers and the types of their values; a null has any type."""
    answer, reference = list_types(answer), list_types(reference)
    assert answer.keys() - reference.keys() == set()
    differing_types = {key: (kind, reference[key]) for key, kind in answer.items() if reference[key] != kind}
    assert {key: kinds for key, kinds in differing_types.items() if "NoneType" not in kinds} == {}
    assert set(required_keys) <= answer.keys()


@pytest.mark.parametrize("title", ANSWERS)
def test_answer_is_a_subset_of_that_of_octoprint(title, octoprint, farm_answers):
    (method, path, body), required_keys = ANSWERS[title]
    answer, reference = (
        farm_answers.ask(method, path, **body),
        octoprint.ask(method, path.removeprefix(PRINTER_PATH), **body),
    )
    assert answer.status_code == reference.status_code, (answer.text, reference.text)
    if "location" in reference.headers:
        reference_path, answer_path = (
            urlsplit(reply.headers["location"]).path for reply in (reference, answer)
        )
        assert answer_path.rpartition("/")[0].startswith(reference_path.rpartition("/")[0])
        # Tokens of app keys are random.
        assert answer_path.endswith(reference_path.rpartition("/")[2]) or "appkeys" in path
    if reference.content:
        assert answer.headers["content-type"] == reference.headers["content-type"]
        compare_answers(answer.json(), reference.json(), required_keys)


@pytest.mark.parametrize("title", REFUSALS)
def test_refusal_has_the_status_of_octoprint_or_of_the_table(title, octoprint, farm_answers):
    (method, path, body), own_status = REFUSALS[title]
    answer, reference = farm_answers.ask(method, path, **body), octoprint.ask(method, path, **body)
    assert answer.status_code == (own_status or reference.status_code), (answer.text, reference.text)
    assert own_status != reference.status_code
    assert answer.headers["content-type"] == "text/plain"  # slicers show this text, but no JSON
