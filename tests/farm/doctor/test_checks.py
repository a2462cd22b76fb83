"""Checks of facts about an installation: each problem has an action."""

from dataclasses import replace

import pytest

from books.make_books import apply_events, make_end_event, make_planned_books
from drivers.messages import PROTOCOL
from farm.config import Fleet
from farm.doctor.checks import check_installation
from farm.doctor.facts import (
    AgentFacts,
    BooksFacts,
    ClockFacts,
    CodeFacts,
    CuraFacts,
    Facts,
    FileFacts,
    FreeSpace,
    PortFacts,
    UserFacts,
)
from farm.doctor.finding import Level
from farm.errors import FarmError
from farm.fleet_file import load_fleet
from farm.model import Bed
from farm.state import events as ev
from farm.state.books import put, replace_fields
from farm.state.retention import DiskUse
from farm.state.storage.migrations import SCHEMA_VERSION
from slicing.errors import EngineMissing
from slicing.settings import find_engine

NOW_S = 1_790_000_000.0
BOOKS = apply_events(
    make_planned_books(),
    ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
    make_end_event("x"),
)[0]
INCONSISTENT_BOOKS = put(BOOKS, replace_fields(BOOKS.printers["a"], bed=Bed.CLEAR))
FLEET = Fleet.model_validate(
    {
        "fleet": {"timezone": "Europe/London", "operators": "ops"},
        "printers": [{"name": "a", "model": "ultimaker2_plus", "port": "/dev/ttyUSB0"}],
    }
)
SOUND_FACTS = Facts(
    version="1.2",
    fleet_path="fleet.yaml",
    books=BooksFacts("/s/farm.db", schema_version=SCHEMA_VERSION, books=BOOKS),
    cura=CuraFacts("/usr/bin/CuraEngine", "4.13.0", None, "/usr/share/cura/resources", "19", None),
    clock=ClockFacts(NOW_S, True, (1.0, NOW_S - 9.0), "Europe/London"),
    user=UserFacts("farm", frozenset({"ops", "dialout"}), frozenset({"ops"}), "farm"),
    daemon_version="1.2",
    fleet=FLEET,
    files=FileFacts(3),
    agents=(AgentFacts("a", True, PROTOCOL),),
    ports=(PortFacts("a", "/dev/ttyUSB0", True, True, "dialout"),),
    free_spaces=(FreeSpace("/s", 10**11),),
    code=CodeFacts("/opt/code", "/home/farm/code", True),
    shared_memory=FreeSpace("/dev/shm", 10**9),
)
STRANGER = UserFacts("farm", frozenset(), frozenset({"ops"}), "farm")
CASES = {
    "no fleet": ({"fleet": None, "fleet_error": "line 3"}, "problem", "fleet", "line 3"),
    "no printers": (
        {"fleet": FLEET.model_copy(update={"printers": ()})},
        "problem",
        "fleet",
        "has no printers",
    ),
    "daemon down": ({"daemon_error": "no answer"}, "warning", "daemon", "no answer"),
    "old daemon": ({"daemon_version": "1.1"}, "warning", "daemon", "farm 1.1, but this program is 1.2"),
    "another's folder": (
        {"user": replace(SOUND_FACTS.user, state_owner="ann")},
        "warning",
        "user",
        "the state folder belongs to ann",
    ),
    "no such group": (
        {"user": replace(SOUND_FACTS.user, existing_groups=frozenset())},
        "problem",
        "groups",
        "there is no group ops",
    ),
    "not an operator": ({"user": STRANGER}, "warning", "groups", "farm is not in the group ops"),
    "damaged books": (
        {"books": BooksFacts("/s/farm.db", error="plate 3 was changed")},
        "problem",
        "database",
        "plate 3 was changed",
    ),
    "inconsistent books": (
        {"books": BooksFacts("/s/farm.db", schema_version=SCHEMA_VERSION, books=INCONSISTENT_BOOKS)},
        "problem",
        "database",
        "printer a: its bed is clear, and print x on it is not judged",
    ),
    "code that is not compiled": (
        {"code": CodeFacts("/opt/code", "/opt/code", False)},
        "warning",
        "code",
        "is not compiled",
    ),
    "code that is not kept": (
        {"code": CodeFacts("/opt/code", None, False)},
        "warning",
        "code",
        "neither /opt/code nor farm's cache",
    ),
    "missing file": ({"files": FileFacts(3, ("job 1: g",))}, "problem", "files", "job 1: g is missing"),
    "changed file": (
        {"files": FileFacts(3, (), ("job 1: g",))},
        "problem",
        "files",
        "job 1: g has changed since it was planned",
    ),
    "dead agent": ({"agents": (AgentFacts("a", False),)}, "problem", "agents", "a: its agent is not running"),
    "silent agent": ({"agents": (AgentFacts("a", True),)}, "problem", "agents", "does not answer"),
    "old agent": ({"agents": (AgentFacts("a", True, 1),)}, "warning", "agents", "earlier version"),
    "closed folder": (
        {"agents": (AgentFacts("a", False, None, "closed"),)},
        "problem",
        "agents",
        "cannot be used: closed",
    ),
    "no port": (
        {"ports": (PortFacts("a", "/dev/x", False),)},
        "problem",
        "ports",
        "a: /dev/x does not exist",
    ),
    "closed port": (
        {"ports": (PortFacts("a", "/dev/x", True, False, "plugdev"),)},
        "problem",
        "ports",
        "farm may not read and write",
    ),
    "no engine": (
        {"cura": replace(SOUND_FACTS.cura, engine=None, engine_error="none: set it")},
        "problem",
        "cura",
        "none",
    ),
    "broken engine": ({"cura": replace(SOUND_FACTS.cura, engine_version=None)}, "problem", "cura", "version"),
    "no settings": (
        {"cura": replace(SOUND_FACTS.cura, resources=None, resources_error="no files: set it")},
        "problem",
        "cura",
        "no files",
    ),
    "clock of 1970": ({"clock": ClockFacts(1000.0, True)}, "problem", "clock", "1970-01-01: it is not set"),
    "no NTP": ({"clock": replace(SOUND_FACTS.clock, is_synchronised=False)}, "warning", "clock", "no NTP"),
    "another scale": (
        {"clock": replace(SOUND_FACTS.clock, scale_and_anchor_s=(60.0, NOW_S))},
        "problem",
        "clock",
        "time_scale 60, but fleet.yaml says 1",
    ),
    "clock set back": (
        {"clock": replace(SOUND_FACTS.clock, scale_and_anchor_s=(1.0, NOW_S + 9e5))},
        "warning",
        "clock",
        "was set back",
    ),
    "another zone": (
        {"clock": replace(SOUND_FACTS.clock, host_zone="Etc/UTC")},
        "warning",
        "clock",
        "Etc/UTC",
    ),
    "full disk": ({"free_spaces": (FreeSpace("/s", 10**6),)}, "problem", "room", "/s has 1 MB free"),
    "soon full": (
        {"disk": DiskUse(free_bytes=3e9, stored_bytes=20e9, prunable_bytes=0.0, daily_bytes=2e9)},
        "warning",
        "room",
        "the disk of /s will be full in about one night (3.0 GB free, 2.0 GB stored per day)",
    ),
    "little room": ({"free_spaces": (FreeSpace("/s", 10**9),)}, "warning", "room", "a large job may not fit"),
    "read-only disk": ({"free_spaces": (FreeSpace("/s", None),)}, "problem", "room", "cannot be written"),
    "no shared memory": (
        {"shared_memory": FreeSpace("/dev/shm", None)},
        "warning",
        "room",
        "/dev/shm cannot be used",
    ),
}


def test_sound_installation_has_no_problem():
    findings = check_installation(SOUND_FACTS)
    assert {item.level for item in findings} == {Level.OK}
    assert not any(item.action for item in findings)


@pytest.mark.parametrize(
    ("groups", "text"),
    [
        ({"ops"}, "the daemon's socket is open to farm alone, as there is no group farm"),
        ({"ops", "farm"}, "the daemon's socket is open to members of farm"),
    ],
)
def test_users_of_the_socket_are_named(groups, text):
    facts = replace(SOUND_FACTS, user=replace(SOUND_FACTS.user, existing_groups=frozenset(groups)))
    assert [item.text for item in check_installation(facts) if item.check == "groups"] == [text]


@pytest.mark.parametrize(("changes", "level", "check", "text"), CASES.values(), ids=CASES)
def test_problem_is_named_with_an_action(changes, level, check, text):
    problems = [
        item for item in check_installation(replace(SOUND_FACTS, **changes)) if item.level is not Level.OK
    ]
    results = [item for item in problems if item.check == check and text in item.text]
    assert [item.level for item in results] == [level]
    assert results[0].action


def test_action_of_a_missing_fleet_file_is_that_of_its_error(tmp_path):
    with pytest.raises(FarmError) as error:
        load_fleet(tmp_path / "fleet.yaml", frozenset())
    facts = replace(SOUND_FACTS, fleet=None, fleet_error=str(error.value))
    (finding,) = (item for item in check_installation(facts) if item.check == "fleet")
    assert finding.text == f"{tmp_path}/fleet.yaml: no such file"
    assert finding.action.startswith("write one with the printers that `farm discover` lists")


def test_stopped_farm_without_books_is_no_problem():
    facts = replace(
        SOUND_FACTS, daemon_error="down", agents=(AgentFacts("a", False),), books=BooksFacts("/s", False)
    )
    problems = [item.check for item in check_installation(facts) if item.level is not Level.OK]
    assert problems == ["daemon"]


def test_missing_engine_is_named_with_one_action():
    with pytest.raises(EngineMissing) as error:
        find_engine({"PATH": ""})
    facts = replace(SOUND_FACTS, cura=replace(SOUND_FACTS.cura, engine=None, engine_error=str(error.value)))
    (finding,) = (item for item in check_installation(facts) if item.level is not Level.OK)
    assert finding.text == "there is no CuraEngine on PATH"
    assert finding.action == "run 'farm setup', or set FARM_CURA_ENGINE to the program"


def test_action_adds_the_user_to_the_group_of_the_port():
    facts = replace(
        SOUND_FACTS, user=STRANGER, ports=(PortFacts("a", "/dev/ttyUSB0", True, False, "dialout"),)
    )
    (port,) = (item for item in check_installation(facts) if item.check == "ports")
    assert port.action == "`sudo usermod -aG dialout farm`, then log in again"


def test_many_missing_files_are_counted():
    names = tuple(f"job 1: {number}" for number in range(9))
    results = [
        item
        for item in check_installation(replace(SOUND_FACTS, files=FileFacts(9, names)))
        if item.check == "files"
    ]
    assert len(results) == 6 and "and 4 more" in results[-1].text
