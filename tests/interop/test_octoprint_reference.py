"""Comparison of the farm's answers with those of OctoPrint: status, keys, types, and `Location`.

OctoPrint's answer has every key of the farm's answer, with the same type. The keys that clients read exist.
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
    pytest.mark.skipif(
        not Path(os.environ.get("FARM_INTEROP", "none")).exists(),
        reason="the peers are missing: make interop",
    ),
]
GCODE = "\n".join(make_marlin()).encode() + b"\n"
UPLOAD_PATH = "/api/files/local"
PRINTER_PATH = "/to/a"  # path of one printer of the farm; OctoPrint has only one printer
FLAGS = ("error", "closedOrError", "paused", "pausing", "printing", "cancelling", "ready", "operational")
UPLOAD_KEYS = ["done", "effectivePrint", "effectiveSelect", "files.local.name", "files.local.origin"]
UPLOAD_KEYS += ["files.local.path", "files.local.refs.resource"]


def make_upload(*fields, name="part.gcode", content=GCODE):
    """Make a form of fields in the given order, in which None stands for the file."""
    file = ("file", (name, content, "application/octet-stream"))
    return {"files": [file if field is None else (field[0], (None, field[1])) for field in fields]}


ANSWERS = {  # title -> (method, path, body) and the keys that clients read
    "version": (("GET", "/api/version", {}), ["api", "server", "text"]),
    "settings": (("GET", "/api/settings", {}), ["feature.sdSupport", "plugins", "webcam"]),
    "printer": (("GET", "/api/printer", {}), [*(f"state.flags.{flag}" for flag in FLAGS), "state.text"]),
    "one printer": (
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
    "files of local": (("GET", UPLOAD_PATH, {}), ["files"]),
    "upload": (("POST", UPLOAD_PATH, make_upload(("print", "false"), ("path", ""), None)), UPLOAD_KEYS),
    "upload, file first": (
        ("POST", UPLOAD_PATH, make_upload(("path", ""), None, ("select", "true"))),
        UPLOAD_KEYS,
    ),
    "upload and print": (
        ("POST", UPLOAD_PATH, make_upload(("print", "true"), ("path", ""), None)),
        UPLOAD_KEYS,
    ),
    "probe for app keys": (("GET", "/plugin/appkeys/probe", {}), []),
    "request of an app key": (("POST", "/plugin/appkeys/request", {"json": {"app": "Cura"}}), ["app_token"]),
}
REFUSALS = {  # title -> (method, path, body) and the farm's status if it differs from OctoPrint's
    "no file": (("POST", UPLOAD_PATH, make_upload(("print", "false"))), None),
    "file that is not G-code": (("POST", UPLOAD_PATH, make_upload(None, name="a.txt")), 400),
    "unknown storage": (("POST", "/api/files/nowhere", make_upload(None)), None),
    "select an unknown file": (("POST", f"{UPLOAD_PATH}/none.gcode", {"json": {"command": "select"}}), None),
    "unknown address": (("GET", "/api/nothing", {}), None),
    "no key": (("GET", "/api/version", {"key": None}), 401),  # OctoPrint has guests with fewer rights
    "wrong key": (("GET", "/api/version", {"key": "nonsense"}), 401),
}


@pytest.fixture(scope="module")
def octoprint(tmp_path_factory):
    server = OctoPrintServer(tmp_path_factory.mktemp("octoprint"))
    server.ask("POST", UPLOAD_PATH, **make_upload(("select", "true"), None)).raise_for_status()
    yield server
    server.close()


class FarmAnswers:
    """A farm, and requests to it with a key that may print."""

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


def list_types(value, parent=""):
    """Return the types of the values in JSON by their paths, in which `*` is the name of any profile."""
    if isinstance(value, dict):
        children = {f"{parent}.{'*' if parent == '.profiles' else key}": item for key, item in value.items()}
        types = {
            path: kind for name, item in children.items() for path, kind in list_types(item, name).items()
        }
        return {parent.lstrip("."): "dict", **types}
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return {parent.lstrip("."): "number" if is_number else type(value).__name__}


def compare_answers(answer, reference, required_keys):
    """Compare the keys of two answers and the types of their values; null matches any type."""
    answer, reference = list_types(answer), list_types(reference)
    assert answer.keys() - reference.keys() == set()
    differing_types = {key: (kind, reference[key]) for key, kind in answer.items() if reference[key] != kind}
    assert {key: kinds for key, kinds in differing_types.items() if "NoneType" not in kinds} == {}
    assert set(required_keys) <= answer.keys()


@pytest.mark.parametrize("title", ANSWERS)
def test_answer_has_only_keys_and_types_of_octoprint(title, octoprint, farm_answers):
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
def test_refusal_has_the_expected_status(title, octoprint, farm_answers):
    (method, path, body), own_status = REFUSALS[title]
    answer, reference = farm_answers.ask(method, path, **body), octoprint.ask(method, path, **body)
    assert answer.status_code == (own_status or reference.status_code), (answer.text, reference.text)
    assert own_status != reference.status_code
    assert answer.headers["content-type"] == "text/plain"  # slicers show plain text, but not JSON
