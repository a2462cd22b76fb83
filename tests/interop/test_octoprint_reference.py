"""The same requests to OctoPrint and to the farm: status, keys and types of the answers, and `Location`.

Every key that the farm gives is one of OctoPrint's, of the same type, and those that clients read are there.
"""

import os
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from farm.model import Role
from make_gcode import marlin
from octoprint_server import OctoPrintServer
from same_process import SameProcess
from web_farm import WebFarm

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not Path(os.environ.get("FARM_INTEROP", "none")).exists(), reason="make interop"),
]
GCODE = "\n".join(marlin()).encode() + b"\n"
UPLOAD = "/api/files/local"
FORM = ["done", "effectivePrint", "effectiveSelect", "files.local.name", "files.local.origin"]
FORM += ["files.local.path", "files.local.refs.resource"]


def upload(*fields, name="part.gcode", content=GCODE):
    """Form with fields and a file, in the order given; None stands for the file."""
    file = ("file", (name, content, "application/octet-stream"))
    return {"files": [file if field is None else (field[0], (None, field[1])) for field in fields]}


ANSWERS = {  # title -> (method, path, body), keys that clients read
    "version": (("GET", "/api/version", {}), ["api", "server", "text"]),
    "upload": (("POST", UPLOAD, upload(("print", "false"), ("path", ""), None)), FORM),
    "upload, file first": (("POST", UPLOAD, upload(("path", ""), None, ("select", "true"))), FORM),
    "upload and print": (("POST", UPLOAD, upload(("print", "true"), ("path", ""), None)), FORM),
}
REFUSALS = {  # title -> (method, path, body), status of the farm where it is another
    "no file": (("POST", UPLOAD, upload(("print", "false"))), None),
    "file that is no G-code": (("POST", UPLOAD, upload(None, name="a.txt")), 400),
    "unknown storage": (("POST", "/api/files/nowhere", upload(None)), None),
    "select an unknown file": (("POST", f"{UPLOAD}/none.gcode", {"json": {"command": "select"}}), None),
    "unknown address": (("GET", "/api/nothing", {}), None),
    "no key": (("GET", "/api/version", {"text": None}), 401),  # OctoPrint has guests, who may do less
    "wrong key": (("GET", "/api/version", {"text": "nonsense"}), 401),
}


@pytest.fixture(scope="module")
def octoprint(tmp_path_factory):
    server = OctoPrintServer(tmp_path_factory.mktemp("octoprint"))
    yield server
    server.close()


class Ours:
    """The farm, asked as OctoPrint is."""

    def __init__(self, folder):
        self.farm = WebFarm(folder, workers=SameProcess())
        self.farm.ready("a", nozzle_c=25.0, bed_c=24.0, nozzle_target_c=0.0, bed_target_c=0.0)
        self._key = self.farm.add_key(Role.PRINT)

    def ask(self, method, path, text="", **more):
        own = self._key if text == "" else text and SimpleNamespace(text=text)
        return self.farm.ask(method, path, own, **more)


@pytest.fixture
def ours(tmp_path):
    return Ours(tmp_path)


def list_types(value, at=""):
    """Return the type of each value in JSON by its path; profiles have any name."""
    if isinstance(value, dict):
        names = {f"{at}.{'*' if at == '.profiles' else key}": inner for key, inner in value.items()}
        return {path: kind for name, inner in names.items() for path, kind in list_types(inner, name).items()}
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return {at.lstrip("."): "number" if number else type(value).__name__}


def compare(own, other, needed):
    """Compare the keys of two answers, and the types of their values; None stands for any."""
    own, other = list_types(own), list_types(other)
    strangers = {key for key in own if not any(one == key or one.startswith(f"{key}.") for one in other)}
    assert strangers == set()
    differing = {key: (kind, other[key]) for key, kind in own.items() if other.get(key, kind) != kind}
    assert {key: kinds for key, kinds in differing.items() if "NoneType" not in kinds} == {}
    for key in needed:
        assert any(one == key or one.startswith(f"{key}.") for one in own), key
        assert any(one == key or one.startswith(f"{key}.") for one in other), key


@pytest.mark.parametrize("title", ANSWERS)
def test_answer_is_a_part_of_octoprint_s(title, octoprint, ours):
    (method, path, body), needed = ANSWERS[title]
    own, other = ours.ask(method, path, **body), octoprint.ask(method, path, **body)
    assert own.status_code == other.status_code, (own.text, other.text)
    assert own.headers.get("content-type") == other.headers.get("content-type")
    if "location" in other.headers:
        there, here = (urlsplit(one.headers["location"]).path for one in (other, own))
        assert here.rpartition("/")[0].startswith(there.rpartition("/")[0])
        assert here.endswith(there.rpartition("/")[2]) or "appkeys" in path
    if other.content:
        compare(own.json(), other.json(), needed)


@pytest.mark.parametrize("title", REFUSALS)
def test_refusal_has_octoprint_s_status_or_the_one_in_the_table(title, octoprint, ours):
    (method, path, body), differs = REFUSALS[title]
    own, other = ours.ask(method, path, **body), octoprint.ask(method, path, **body)
    assert own.status_code == (differs or other.status_code), (own.text, other.text)
    assert differs != other.status_code
    assert own.headers["content-type"] == "text/plain"  # which slicers show, as they do not JSON
