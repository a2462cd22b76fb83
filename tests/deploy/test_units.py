"""Units of systemd, udev rules, and the configuration of needrestart."""

import importlib.util
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.clock import Clock
from drivers.records import StartFile
from drivers.remote import spawn_agent

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))


def replace_host_names(text: str) -> str:
    """Replace the programs and the user of a unit by some that exist on any host."""
    text = re.sub(r"/opt/farm/\.venv/bin/\w+", "/bin/true", text)
    return text.replace("=farm\n", "=root\n").replace("/opt/farm", "/")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd")
def test_systemd_accepts_the_units_without_a_warning(tmp_path: Path):
    paths = []
    for unit in UNITS:
        path = tmp_path / unit.name.replace("@.", "@um2-01.")
        path.write_text(replace_host_names(unit.read_text()))
        paths.append(path)
    command = ["systemd-analyze", "verify", "--man=no", *map(str, paths)]
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    warnings = [line for line in process.stderr.splitlines() if "farm-" in line]
    assert (process.returncode, warnings) == (0, []), process.stderr


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_unit_starts_an_existing_program(unit: Path):
    [command] = re.findall(r"^ExecStart=/opt/farm/\.venv/bin/(.+)$", unit.read_text(), re.MULTILINE)
    if (module := re.match(r"python -m (\S+)", command)) is not None:
        assert importlib.util.find_spec(module[1]) is not None
    else:
        assert command == "farm daemon"


@pytest.mark.skipif(shutil.which("systemd-socket-activate") is None, reason="needs systemd")
def test_estop_service_receives_the_listening_socket_of_its_unit(tmp_path: Path):
    folder = DEPLOY / "systemd"
    assert "Accept=no" in (folder / "farm-estop.socket").read_text()
    service = (folder / "farm-estop.service").read_text()
    assert "StandardInput=socket" in service
    [module] = re.findall(r"^ExecStart=\S+/python -m (\S+)$", service, re.MULTILINE)
    path = tmp_path / "estop.sock"
    command = ["systemd-socket-activate", "--inetd", "-l", str(path), sys.executable, "-m", module]
    command += ["--state", str(tmp_path / "state"), "--fleet", str(tmp_path / "fleet.yaml")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        try:
            assert server.stderr is not None and "Listening" in server.stderr.readline()
            for _ in range(2):  # the same process serves the second client
                with socket.socket(socket.AF_UNIX) as client:
                    client.settimeout(60.0)
                    client.connect(str(path))
                    client.sendall(b'{"printers":["um2-01"]}\n')
                    output = client.makefile().read()
                assert '"over":true' in output and "fleet.yaml" in output
        finally:
            server.kill()


def test_unit_of_an_agent_waits_for_its_print_and_depends_on_no_unit_that_may_stop():
    text = (DEPLOY / "systemd" / "farm-agent@.service").read_text()
    assert "TimeoutStopSec=infinity" in text and "KillMode=mixed" in text
    assert not re.search(r"^(Requires|BindsTo|PartOf|Requisite)=", text, re.MULTILINE)


@pytest.mark.skipif(shutil.which("perl") is None, reason="needs perl")
def test_needrestart_restarts_everything_except_agents():
    perl = (
        "our %nrconf; do $ARGV[0]; die $@ if $@; my ($re) = keys %{$nrconf{override_rc}}; "
        "for (@ARGV[1,2]) { print /$re/ ? 1 : 0 }"
    )
    command = ["perl", "-e", perl, str(DEPLOY / "needrestart" / "farm.conf")]
    command += ["farm-agent@um2-01.service", "farm-daemon.service"]
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    assert process.stdout == "10", process.stderr


def test_agent_is_started_as_its_unit_under_systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    systemctl = tmp_path / "systemctl"
    systemctl.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/calls\n')
    systemctl.chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    [unit] = re.findall(r"FARM_AGENT_UNIT=(\S+)", (DEPLOY / "systemd" / "farm-daemon.service").read_text())
    monkeypatch.setenv("FARM_AGENT_UNIT", unit.replace("%%", "%"))
    folder = tmp_path / "agents" / "um2-01"
    process = spawn_agent("um2-01", "ultimaker2_plus", "/dev/null", folder, Clock(2.0, 5.0), "relay")
    assert process.wait(10.0) == 0
    assert (tmp_path / "calls").read_text() == "start farm-agent@um2-01.service\n"
    assert StartFile.read(folder) == StartFile("um2-01", "ultimaker2_plus", "/dev/null", 2.0, 5.0, "relay")


def find_properties(event: dict[str, str]) -> dict[str, str]:
    """Return the properties that the udev rules set for a device, by a parser of only their operators."""
    properties: dict[str, str] = {}
    skip_to = ""
    for line in (DEPLOY / "udev" / "60-farm.rules").read_text().splitlines():
        terms = re.findall(r'([A-Z_]+(?:\{[^}]*\})?)(==|!=|=)"([^"]*)"', line)
        if skip_to:
            skip_to = "" if ("LABEL", "=", skip_to) in terms else skip_to
            continue
        if all(
            (event.get(key, "") in value.split("|")) is (op == "==") for key, op, value in terms if op != "="
        ):
            properties |= {key: value for key, op, value in terms if op == "="}
            skip_to = properties.pop("GOTO", "")
    return properties


@pytest.mark.parametrize("subsystem", ["usb", "tty"])
@pytest.mark.parametrize("product", ["0010", "0042"])
def test_modem_manager_ignores_printer_boards_only(subsystem: str, product: str):
    event = {"ACTION": "add", "SUBSYSTEM": subsystem, "ATTRS{idVendor}": "2341", "ATTRS{idProduct}": product}
    properties = find_properties(event)
    assert (properties["ENV{ID_MM_DEVICE_IGNORE}"], properties["ENV{ID_MM_PORT_IGNORE}"]) == ("1", "1")
    assert properties.get("GROUP") == ("dialout" if subsystem == "tty" else None)
    for other_device in (
        {"ATTRS{idVendor}": "1a86"},
        {"ATTRS{idProduct}": "9999"},
        {"ACTION": "remove"},
        {"SUBSYSTEM": "net"},
    ):
        assert not any(key.startswith("ENV") for key in find_properties(event | other_device))
