"""A short night that `bench/night.py` simulates."""

from __future__ import annotations

import pytest

from bench.night import Night, parse_options

pytestmark = pytest.mark.system


def test_night_loses_no_plate_and_prints_none_twice(tmp_path):
    """Fail a print, unplug a printer, kill the daemon, and leave beds unattended for half an hour."""
    options = "--printers 5 --plates 10 --moves 100 --away-h 0.5 --kills 1 --seed 1"
    figures = Night(tmp_path, parse_options(options.split())).run()
    assert (figures["done"], figures["lost"], figures["printed_twice"]) == (10, 0, 0), figures
    assert figures["failed"] >= 2, figures
    assert figures["daemon_killed"] == 1
    assert figures["unplugged"] is not None
