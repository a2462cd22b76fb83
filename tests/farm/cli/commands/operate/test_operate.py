"""Commands for jobs, parts and printers: their arguments and output."""

import pytest
from typer.testing import CliRunner

from farm.api import JobStatus, JobView, LoadRequest, PlateStatus, PrinterView, Reel
from farm.cli.commands import operate, submit
from farm.cli.commands.operate import find_target_path, select_printers_to_clear
from farm.cli.main import app
from farm.model import Hold, HoldCode


@pytest.mark.parametrize(
    ("target", "path"),
    [
        ("3", "/jobs/3"),
        ("3/p01", "/jobs/3/parts/p01"),
        ("3/1", "/jobs/3/parts/1"),
        ("3/p01a", "/jobs/3/parts/p01a"),
        ("3/p01.2", "/jobs/3/parts/p01.2"),
        ("3/01.12b", "/jobs/3/parts/01.12b"),
        ("um2-03", "/printers/um2-03"),
    ],
)
def test_target_path_is_found_for_job_part_and_printer(target, path):
    assert find_target_path(target) == path


def test_option_all_selects_the_beds_to_clear():
    hold = Hold(code=HoldCode.BED_NOT_CLEAR, text="")
    states = ("idle", "maintenance", "look", "absent", "connecting")
    fleet = [PrinterView.model_construct(name=state, state=state, print=None, hold=hold) for state in states]
    clear_printer = PrinterView.model_construct(name="clear", state="idle", print=None, hold=None)
    assert select_printers_to_clear([*fleet, clear_printer]) == ["idle", "look", "connecting"]


@pytest.mark.parametrize(
    ("printers", "expected_text"),
    [
        ([], "job 3 is cancelled"),
        (
            ["a"],
            "job 3 is cancelled; a: the print ends safely; remove the parts, then `farm cleared PRINTER`",
        ),
        (
            ["b", "a"],
            "job 3 is cancelled; a b: the prints end safely; remove the parts, then `farm cleared PRINTER`",
        ),
    ],
)
def test_cancel_names_the_beds_to_clear(printers, expected_text, monkeypatch):
    class FakeDaemon:
        def __init__(self, _):
            pass

        def cancel_job(self, number):
            plates = [PlateStatus.model_construct(printer=name, printing=True) for name in printers]
            return JobStatus.model_construct(job=JobView.model_construct(plates=plates))

    monkeypatch.setattr(operate, "connect", FakeDaemon)
    assert CliRunner().invoke(app, ["cancel", "3"]).stdout == f"{expected_text}\n"


def test_interrupted_upload_may_have_been_submitted(tmp_path, monkeypatch):
    class FakeDaemon:
        def __init__(self, _):
            pass

        def submit(self, model, options, **_):
            raise KeyboardInterrupt

    monkeypatch.setattr(submit, "connect", FakeDaemon)
    (tmp_path / "part.stl").touch()
    result = CliRunner().invoke(app, ["submit", str(tmp_path / "part.stl")])
    assert result.exit_code == 130
    assert "part.stl may have been submitted" in result.stderr


class RecordingDaemon:
    """Daemon that records loaded reels and nozzles."""

    def __init__(self):
        self.requests = []

    def load_reel(self, printer, request):
        self.requests.append((printer, request))
        return Reel(material="generic_abs", kind="ABS", colour="black", grams=750.0, nozzle_mm=0.6)


def test_reel_is_described_in_words(monkeypatch):
    daemon = RecordingDaemon()
    monkeypatch.setattr(operate, "connect", lambda paths: daemon)
    result = CliRunner().invoke(app, ["load", "um2-01", "black ABS", "--grams", "750"])
    assert result.stdout == "um2-01: black ABS, 750 g, nozzle 0.6 mm\n"
    assert daemon.requests == [("um2-01", LoadRequest(material="black ABS", grams=750.0))]


def test_material_given_twice_is_refused(monkeypatch):
    monkeypatch.setattr(operate, "connect", lambda paths: RecordingDaemon())
    result = CliRunner().invoke(app, ["load", "um2-01", "ABS", "--material", "PLA"])
    assert result.exit_code != 0
