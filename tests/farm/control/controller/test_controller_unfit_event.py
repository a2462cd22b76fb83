"""Snapshots that do not fit the books are logged with the history, and do not affect other printers."""

import logging

from books.recording_controller import Farm
from farm.control import telemetry
from farm.model import Bed, PrintState
from farm.state import events as ev


def test_unfit_snapshot_is_logged_and_other_printers_continue(tmp_path, monkeypatch, caplog):
    farm = Farm(tmp_path / "farm")
    farm.report_ready("a", "b", bed_clear=False)
    reconcile = telemetry.reconcile_idle_printer

    def reconcile_unfit_snapshot(printer, snapshot, now_s):
        if printer.name == "a":
            yield ev.PrinterAdded(at_s=now_s, printer="a", bed=Bed.CLEAR)
        yield from reconcile(printer, snapshot, now_s)

    monkeypatch.setattr(telemetry, "reconcile_idle_printer", reconcile_unfit_snapshot)
    old_books = farm.controller.books
    with caplog.at_level(logging.ERROR):
        farm.report_ready("a", nozzle_c=31.0)
    assert farm.controller.books == old_books
    assert "PrinterAdded is not allowed: printer a is not_clear; before that: " in caplog.text
    assert "PrinterAdded, " in caplog.text and "BedReported" in caplog.text
    assert farm.controller.telemetry.snapshots["a"].nozzle_c == 31.0  # the snapshot is shown nevertheless
    farm.report_ready("b", nozzle_c=32.0, print=None)
    assert farm.controller.telemetry.snapshots["b"].nozzle_c == 32.0
    assert not any(p.state is PrintState.ASSIGNED for p in farm.controller.books.prints.values())
