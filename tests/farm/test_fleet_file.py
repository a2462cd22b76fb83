"""fleet.yaml: every error has a line, a field and advice."""

import re
from pathlib import Path

import pytest

from farm.errors import ExitCode, FleetFileError
from farm.fleet_file import load_fleet
from farm.planning.inspection.fleet_check import complete_section

MODELS = frozenset({"ultimaker2_plus", "ultimaker2_extended_plus"})
ROOT = Path(__file__).parents[2]


def load_fleet_text(tmp_path, text, *check):
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    return load_fleet(path, MODELS, *check)


VALID_TEXT = """
fleet: {name: lab, timezone: Europe/Zurich}
defaults: {model: ultimaker2_plus, colour: red}
printers:
  - {name: a, port: /dev/serial/by-path/one}
  - {name: b, port: /dev/serial/by-path/two, colour: blue}
"""


def test_defaults_apply_unless_a_printer_overrides_them(tmp_path):
    fleet = load_fleet_text(tmp_path, VALID_TEXT)
    assert [(p.model, p.colour) for p in fleet.printers] == [
        ("ultimaker2_plus", "red"),
        ("ultimaker2_plus", "blue"),
    ]
    assert fleet.zone.key == "Europe/Zurich"
    assert fleet.find_printer("b").colour == "blue"


def test_printers_have_the_fit_of_the_fleet_unless_they_have_their_own(tmp_path):
    fleet = load_fleet_text(
        tmp_path,
        VALID_TEXT.replace("{name: lab", "{pin_fit_mm: 0.5").replace("blue}", "blue, pin_fit_mm: 0}"),
    )
    assert [p.pin_fit_mm for p in fleet.printers] == [0.5, 0.0]
    assert [p.pin_fit_mm for p in load_fleet_text(tmp_path, VALID_TEXT).printers] == [None, None]


def test_reel_has_a_price_if_given(tmp_path):
    priced_text = VALID_TEXT.replace("timezone", "currency: CHF, timezone").replace(
        "colour: red", "price_per_kg: 28.50"
    )
    fleet = load_fleet_text(tmp_path, priced_text.replace("colour: blue", "price_per_kg: 0"))
    assert fleet.fleet.currency == "CHF"
    assert [p.compute_price(200.0) for p in fleet.printers] == [pytest.approx(5.70), 0.0]
    assert [p.compute_price(200.0) for p in load_fleet_text(tmp_path, VALID_TEXT).printers] == [None, None]


def test_hours_are_one_window_or_a_list(tmp_path):
    hours = "attended: [mon-fri 08:00-18:00, sat 10:00-14:00], quiet: 22:00-06:00, timezone"
    fleet_section = load_fleet_text(tmp_path, VALID_TEXT.replace("timezone", hours)).fleet
    assert [len(window.days) for window in fleet_section.attended] == [5, 1]
    assert [len(window.days) for window in fleet_section.quiet] == [7]


def test_fleet_file_of_the_repository_is_valid():
    fleet = load_fleet(ROOT / "fleet.yaml", MODELS)
    assert [p.model for p in fleet.printers].count("ultimaker2_plus") == 5
    assert len(fleet.printers) == 8


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("printers: [", "not YAML"),
        (
            VALID_TEXT.replace("name: lab", "quiet: at night"),
            "fleet.yaml:2: fleet.quiet: 'at night' is not a weekly time",
        ),
        (VALID_TEXT.replace("name: lab", "attended: mo 8:00-9:00"), "'mo' is not a day; use mon"),
        (
            VALID_TEXT.replace("name: lab", "first_layers_attended: true"),
            "needs `attended` hours under `fleet`",
        ),
        (
            VALID_TEXT.replace("colour: red", "unattended: false"),
            "a has `unattended: false`: this needs `attended` hours",
        ),
        (
            VALID_TEXT.replace("name: lab", "keep: {days: 1}"),
            "fleet.yaml:2: fleet.keep.days: must be at least 2",
        ),
        (
            VALID_TEXT.replace("name: lab", "keep: {nights: 3}"),
            "fleet.yaml:2: fleet.keep.nights: unknown key; the known keys are days, gb",
        ),
        (
            VALID_TEXT.replace("colour: blue", "price_per_kg: -1"),
            "fleet.yaml:6: printers.1.price_per_kg: must be at least 0",
        ),
        (
            VALID_TEXT.replace("colour: red", "price_per_kg: .inf"),
            "fleet.yaml:3: defaults.price_per_kg: must be a number",
        ),
        (
            VALID_TEXT.replace("name: lab", "currency: pounds sterling"),
            "fleet.yaml:2: fleet.currency: must be at most 8 characters long",
        ),
        ("- a", "needs a list `printers`"),
        (VALID_TEXT.replace("colour: blue", "colur: blue"), "fleet.yaml:6: printers.1.colur: unknown key"),
        (VALID_TEXT.replace("two", "one"), "fleet.yaml:6: printers.1.port: a and b are on one port"),
        (VALID_TEXT.replace("name: b", "name: a"), "fleet.yaml:6: printers.1.name: two printers are named a"),
        (VALID_TEXT.replace("Europe/Zurich", "Europe/Zuerich"), "fleet.yaml:2: fleet.timezone"),
        (
            VALID_TEXT.replace("timezone", "time_scale: 5, timezone"),
            "fleet.yaml:2: fleet.time_scale: must be 1 unless every port",
        ),
        (VALID_TEXT.replace("/dev/serial/by-path/one", "COM3"), "fleet.yaml:5: printers.0.port"),
        (VALID_TEXT.replace("/dev/serial/by-path/one", "socket://h:1"), "no DTR"),
        (
            VALID_TEXT.replace("/dev/serial/by-path/one", "sim://ultimaker2_extended_plus"),
            "a model other than",
        ),
        (
            VALID_TEXT.replace("model: ultimaker2_plus", "model: prusa"),
            "'prusa' is not a supported printer",
        ),
        (VALID_TEXT.replace("name: a,", "name: ../a,"), "printers.0.name"),
        (
            VALID_TEXT.replace("timezone", "compute: {cores: 2}, timezone"),
            "the known keys are workers, memory_gb, budget_s",
        ),
        (
            VALID_TEXT.replace("timezone", "compute: {workers: 0}, timezone"),
            "fleet.yaml:2: fleet.compute.workers",
        ),
        (VALID_TEXT.replace("colour: red", "color: red"), "fleet.yaml:3: defaults.color: unknown key"),
        (VALID_TEXT.replace("model: ultimaker2_plus", "model: prusa"), "fleet.yaml:3: defaults.model"),
        (
            VALID_TEXT.replace("name: lab", "max_heating: four"),
            "fleet.yaml:2: fleet.max_heating: must be a whole",
        ),
        (VALID_TEXT.replace("name: lab", "max_heating: 2.5"), "fleet.max_heating: must be a whole number"),
        (VALID_TEXT.replace("name: lab", "max_heating: 0"), "fleet.max_heating: must be at least 1"),
        (VALID_TEXT.replace("name: lab", "time_scale: 5000"), "fleet.time_scale: must be at most 1000"),
        (VALID_TEXT.replace("name: lab", "approve: maybe"), "fleet.approve: must be true or false"),
        (VALID_TEXT.replace("name: lab", "name: 7"), "fleet.name: must be text; put it in quotes"),
        (
            VALID_TEXT.replace("name: lab", "quiet: 22:00"),
            "fleet.quiet: '1320' is not a weekly time window; write it",
        ),
        (
            VALID_TEXT.replace("name: lab", "operators: Lab Staff"),
            "must be a group of this host, like farm-staff",
        ),
        (VALID_TEXT.replace("name: lab", "notify: json://h"), "fleet.notify: must be a list"),
        (VALID_TEXT.replace("name: lab", "name: lab, name: b"), "fleet.yaml:2: fleet.name: appears twice"),
        (VALID_TEXT.replace("name: b, ", ""), "fleet.yaml:6: printers.1.name: is missing"),
        (
            VALID_TEXT.replace("colour: blue", "host: a b"),
            "must be a host as ssh knows it, like user@pc-b, not 'a b'",
        ),
        (
            VALID_TEXT.replace("colour: red", "host_command: /srv/farm/bin/python -m drivers.bridge"),
            "fleet.yaml:3: defaults.host_command: drivers.bridge has moved: "
            "write '/srv/farm/bin/python -m drivers.remote.bridge'",
        ),
        (VALID_TEXT.replace("colour: blue", "nozzle_mm: 0"), "printers.1.nozzle_mm: must be more than 0"),
        (VALID_TEXT.replace("colour: blue", "volume_mm: [200, 200]"), "volume_mm.2: has one value too few"),
        (VALID_TEXT.replace("colour: blue", "volume_mm: [1, 2, 3, 4]"), "volume_mm: has 4 values; 3 at most"),
        (VALID_TEXT.replace("colour: blue", "volume_mm: 2x2x2"), "printers.1.volume_mm: must be a list"),
        (VALID_TEXT + "  - um2-03\n", "fleet.yaml:7: printers.2: must be keys with values"),
        (
            VALID_TEXT + "colour: red\n",
            "fleet.yaml:7: colour: unknown key; the known keys are fleet, web, printers, defaults",
        ),
        ("fleet: lab\nprinters: []", "fleet.yaml:1: fleet: must be keys with values"),
        (VALID_TEXT.replace("name: lab", "name: 2026-02-30"), "fleet.yaml:2: not YAML: day is out of range"),
        (VALID_TEXT.replace("colour: blue", "nozzle_mm: " + "9" * 5000), "fleet.yaml:6: not YAML: Exceeds"),
        (VALID_TEXT.replace("name: lab", "approve: !!bool perhaps"), "fleet.yaml:2: not YAML: 'perhaps'"),
        (
            VALID_TEXT.replace("name: lab", "name: " + "[" * 2000 + "]" * 2000),
            "fleet.yaml: nested too deeply",
        ),
        (VALID_TEXT.replace("fleet: {name: lab", "fleet: &here {name: *here"), "fleet.name: must be text"),
        (VALID_TEXT.replace("name: lab", "name: a\0b"), "fleet.yaml: not YAML: unacceptable character"),
        (VALID_TEXT.replace("Europe/Zurich", "Europe"), "fleet.timezone: 'Europe' is not a time zone"),
        (VALID_TEXT.replace("colour: blue", "volume_mm: [.inf, 1, 1]"), "volume_mm.0: must be a number"),
        (
            VALID_TEXT.replace("colour: blue", "power_off_cmd: relay 'one"),
            '6: printers.1.power_off_cmd: "relay',
        ),
        (VALID_TEXT.replace("colour: blue", "power_off_cmd: ''"), "printers.1.power_off_cmd: is empty"),
    ],
)
def test_error_is_reported_in_one_line(tmp_path, text, message):
    with pytest.raises(FleetFileError) as error:
        load_fleet_text(tmp_path, text)
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1
    assert not re.search("Input|String|valid|instance|parse|Field", str(error.value))
    assert error.value.exit_code == ExitCode.USAGE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            VALID_TEXT.replace("model: ultimaker2_plus", "model: ultimaker2_plus, material: PAL"),
            "3: defaults.mat",
        ),
        (
            VALID_TEXT.replace("colour: blue", "material: PETG"),
            "6: printers.1.material: PETG: Cura has no profile",
        ),
        (
            VALID_TEXT.replace("colour: blue", "material: generic_plaa"),
            "6: printers.1.material: generic_plaa: there is no such material; it prints ABS, CPE,",
        ),
        (
            VALID_TEXT.replace("name: lab", "name: lab, materials: mine"),
            "2: fleet.materials: the folder of materials ",
        ),
        (VALID_TEXT.replace("colour: blue", "nozzle_mm: 7"), "6: printers.1.nozzle_mm: nozzle 7 mm"),
        (VALID_TEXT.replace("colour: blue", "nozzle_mm: 7"), "it has 0.25 mm, 0.4 mm, 0.6 mm, 0.8 mm"),
    ],
)
def test_unknown_cura_material_is_reported_as_a_field_error(tmp_path, text, message):
    with pytest.raises(FleetFileError) as error:
        load_fleet_text(tmp_path, text, complete_section)
    assert message in str(error.value)
    assert error.value.exit_code == ExitCode.USAGE


def test_printers_are_checked_only_if_the_files_of_cura_exist(tmp_path, monkeypatch):
    assert len(load_fleet_text(tmp_path, VALID_TEXT, complete_section).printers) == 2
    monkeypatch.setenv("FARM_CURA_RESOURCES", str(tmp_path))
    assert (
        len(
            load_fleet_text(
                tmp_path, VALID_TEXT.replace("colour: blue", "nozzle_mm: 7"), complete_section
            ).printers
        )
        == 2
    )


def test_material_of_a_printer_is_given_by_its_common_name(tmp_path):
    fleet = load_fleet_text(
        tmp_path, VALID_TEXT.replace("colour: blue", "material: red ABS"), complete_section
    )
    assert [(p.material, p.material_kind) for p in fleet.printers] == [
        ("generic_pla", "PLA"),
        ("generic_abs", "ABS"),
    ]
    assert fleet.printers[1].colour == "red"


def test_folder_of_materials_is_relative_to_the_fleet_file(tmp_path):
    (tmp_path / "mine").mkdir()
    fleet = load_fleet_text(
        tmp_path, VALID_TEXT.replace("name: lab", "name: lab, materials: mine"), complete_section
    )
    assert fleet.fleet.materials == tmp_path / "mine"


def test_one_port_under_two_paths_is_detected(tmp_path):
    device = tmp_path / "ttyACM0"
    device.touch()
    link = tmp_path / "by-path"
    link.symlink_to(device)
    text = VALID_TEXT.replace("/dev/serial/by-path/one", str(device)).replace(
        "/dev/serial/by-path/two", str(link)
    )
    with pytest.raises(FleetFileError, match="one port"):
        load_fleet_text(tmp_path, text)


def test_simulated_printers_may_share_an_address(tmp_path):
    text = VALID_TEXT.replace("/dev/serial/by-path/one", "sim://ultimaker2_plus")
    text = text.replace("/dev/serial/by-path/two", "sim://ultimaker2_plus").replace(
        "timezone", "time_scale: 60, timezone"
    )
    assert len(load_fleet_text(tmp_path, text).printers) == 2


def test_missing_or_unreadable_file_is_reported(tmp_path):
    with pytest.raises(FleetFileError, match=r"no\.yaml: no such file; write one .*`farm discover`"):
        load_fleet(tmp_path / "no.yaml", MODELS)
    with pytest.raises(FleetFileError, match=r"cannot be read \(Is a directory\)"):
        load_fleet(tmp_path, MODELS)


NESTED_MERGES = "".join(f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12))
NESTED_LISTS = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
MANY_HOURS = "".join(f"  - mon {i // 60 % 24:02d}:{i % 60:02d}-24:00\n" for i in range(20_000))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "a0: &a0 {k: v}\n" + NESTED_MERGES + VALID_TEXT,
            "expands to more than 100000 values: use fewer aliases",
        ),
        (
            "a0: &a0 [v]\n" + NESTED_LISTS + VALID_TEXT,
            "expands to more than 100000 values: use fewer aliases",
        ),
        (
            "fleet:\n attended:\n" + MANY_HOURS + "printers: []\n",
            ":3: fleet.attended: has 20000 values; 168 at most",
        ),
        ("# and so on\n" * 50_000 + VALID_TEXT, "is larger than 512 KiB: not a fleet file"),
    ],
    ids=["merges", "lists", "hours", "size"],
)
def test_expanding_file_is_refused(tmp_path, text, reason):
    with pytest.raises(FleetFileError) as error:
        load_fleet_text(tmp_path, text)
    assert str(error.value).endswith(reason)


def test_aliases_of_a_usual_file_are_resolved(tmp_path):
    text = """
fleet: {attended: &hours [mon-fri 08:00-18:00], quiet: []}
common: &common {model: ultimaker2_plus, colour: red}
printers: [{<<: *common, name: a, port: /dev/one}]
"""
    with pytest.raises(FleetFileError, match="unknown key"):
        load_fleet_text(tmp_path, text)
    fleet = load_fleet_text(tmp_path, text.replace("common: &common", "defaults: &common"))
    assert fleet.printers[0].colour == "red"


@pytest.mark.parametrize(
    "url",
    [
        "http://camera-1/snapshot.jpg",
        "https://look:pass-w0rd@10.0.0.7:8443/?action=snapshot",
        "http://cameras.lab.example/{printer}.jpg",
        "http://[fd00::7]/",
    ],
)
def test_camera_has_an_http_address(tmp_path, url):
    fleet = load_fleet_text(tmp_path, VALID_TEXT.replace("colour: red", f'camera: "{url}"'))
    assert fleet.find_printer("b").camera_url == url.replace("{printer}", "b")
    assert "pass-w0rd" not in repr(fleet)


@pytest.mark.parametrize(
    "url",
    [
        "file:///etc/passwd",
        "rtsp://look:pass-w0rd@camera-1/",
        "camera-1/snapshot.jpg",
        "http://",
        "http://look:pass-w0rd@/",
        "http://camera-1:pass-w0rd/",
        "http://camera-1:0/",
        "http://[fd00/",
        "http://camera-1/\\n",
        "",
        "[pass-w0rd]",
    ],
)
def test_invalid_camera_addresses_are_refused_without_showing_them(tmp_path, url):
    with pytest.raises(FleetFileError, match=r"fleet.yaml:3: defaults.camera: must be the address") as error:
        load_fleet_text(tmp_path, VALID_TEXT.replace("colour: red", f'camera: "{url}"'))
    assert "pass-w0rd" not in str(error.value)


CLUSTER_TEXT = VALID_TEXT.replace("timezone", "compute: {scheduler: 'SCHEDULER'CERTIFICATES}, timezone")


@pytest.mark.parametrize(
    ("scheduler", "certificates", "advice"),
    [
        ("pc-a:8786", "", "'pc-a:8786' is not the address of a scheduler: use tls://HOST:PORT"),
        ("tls://pc-a", "", "use tls://HOST:PORT"),
        ("tls://pc-a:99999", "", "use tls://HOST:PORT"),
        ("tcp://pc-a:8786", "", "is not encrypted: use tls://HOST:PORT, except on this computer"),
        ("tls://pc-a:8786", "", "fleet.compute.certificates: is needed for a scheduler with TLS"),
    ],
)
def test_cluster_without_a_valid_address_or_certificates_is_refused(
    tmp_path, scheduler, certificates, advice
):
    text = CLUSTER_TEXT.replace("SCHEDULER", scheduler).replace("CERTIFICATES", certificates)
    with pytest.raises(FleetFileError, match=re.escape(advice)):
        load_fleet_text(tmp_path, text)


def test_path_of_certificates_is_relative_to_the_fleet_file(tmp_path):
    text = CLUSTER_TEXT.replace("SCHEDULER", "tls://pc-a:8786").replace("CERTIFICATES", ", certificates: tls")
    assert load_fleet_text(tmp_path, text).fleet.compute.certificates == tmp_path / "tls"
    local_text = CLUSTER_TEXT.replace("SCHEDULER", "tcp://127.0.0.1:8786").replace("CERTIFICATES", "")
    assert load_fleet_text(tmp_path, local_text).fleet.compute.scheduler == "tcp://127.0.0.1:8786"
