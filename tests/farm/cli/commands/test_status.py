"""Commands that only read the state of the farm."""

import pytest
from typer.testing import CliRunner

from farm import api
from farm.cli.commands import status
from farm.cli.main import app


class Daemon:
    """Daemon without ended prints."""

    def __init__(self, _: object) -> None:
        pass

    def fetch_history(self, job: int | None, printer: str | None, count: int) -> api.History:
        return api.History(now="2026-11-22T07:00:00+00:00", prints=[])


@pytest.mark.parametrize(("options", "output"), [([], "no print has ended\n"), (["--json"], '"prints": []')])
def test_empty_history_is_reported_in_a_sentence(monkeypatch: pytest.MonkeyPatch, options, output):
    monkeypatch.setattr(status, "connect", Daemon)
    assert output in CliRunner().invoke(app, ["history", *options]).stdout


class DaemonWithSpeeds(Daemon):
    """Daemon of two printers, one with a known speed by feature, and one with too few prints."""

    def fetch_history(self, job: int | None, printer: str | None, count: int) -> api.History:
        row = api.HistoryRow(
            part="1/p01",
            printer="um2-01",
            state="done",
            fault=None,
            reason=None,
            verdict=None,
            why=None,
            started=None,
            ended="2026-11-22T06:00:00+00:00",
            job=1,
            name="bust.stl",
            note=None,
            submitted_by=None,
            took_s=3600.0,
            expected_s=3500.0,
            grams=10.0,
            wasted=False,
        )
        factors = api.FeatureFactorsView(
            walls=1.02, infill=0.98, skins=1.15, supports=1.0, travel=1.31, prints=42, own=False
        )
        speeds = [
            api.PrinterSpeed(printer="um2-01", time_factor=1.07, feature_factors=factors),
            api.PrinterSpeed(printer="um2-02", time_factor=1.0, feature_factors=None),
        ]
        return api.History(now="2026-11-22T07:00:00+00:00", prints=[row], speeds=speeds)


def test_history_shows_the_speed_by_feature(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(status, "connect", DaemonWithSpeeds)
    monkeypatch.setenv("COLUMNS", "160")
    heading, row = CliRunner().invoke(app, ["history"]).stdout.splitlines()[-2:]
    assert heading.split() == [
        *("PRINTER", "FACTOR", "WALLS", "INFILL", "SKINS", "SUPPORTS", "TRAVEL", "LEARNED", "FROM")
    ]
    assert row.split() == [
        *("um2-01", "1.07", "1.02", "0.98", "1.15", "1.00", "1.31", "42", "prints", "of", "its", "family")
    ]
    json_text = CliRunner().invoke(app, ["history", "--json"]).stdout
    assert api.History.model_validate_json(json_text).speeds[0].feature_factors.prints == 42
