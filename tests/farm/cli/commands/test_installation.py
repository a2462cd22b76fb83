"""Output of `farm discover`."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers import discovery
from drivers.discovery import PluggedDevice
from drivers.printers import PROFILES
from farm.cli.main import app
from farm.fleet_file import load_fleet


def test_entries_for_new_printers_are_valid_in_a_fleet_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("printers:\n  - {name: um2-01, model: ultimaker2_plus, port: /dev/known}\n")
    rows = [
        PluggedDevice(Path("/dev/serial/by-path/pci-0:1:1.0"), Path("/dev/ttyACM0"), "a board", None),
        PluggedDevice(Path("/dev/known"), Path("/dev/ttyACM1"), "a board", "um2-01"),
        PluggedDevice(Path("/dev/serial/by-path/pci-0:2:1.0"), Path("/dev/ttyACM2"), "a board", None),
    ]
    monkeypatch.setattr(discovery, "list_plugged_devices", lambda _: rows)
    output = CliRunner().invoke(app, ["discover", "--fleet", str(fleet), "--state", str(tmp_path)]).stdout
    assert "/dev/known  a board  um2-01" in output
    lines = [line for line in output.splitlines() if line.startswith("  - {")]
    fleet.write_text(fleet.read_text() + "\n".join(lines) + "\n")
    printers = load_fleet(fleet, frozenset(PROFILES)).printers
    assert [(printer.name, printer.port) for printer in printers] == [
        ("um2-01", "/dev/known"),
        ("um2-02", "/dev/serial/by-path/pci-0:1:1.0"),
        ("um2-03", "/dev/serial/by-path/pci-0:2:1.0"),
    ]
