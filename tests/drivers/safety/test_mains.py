"""Command that cuts the mains of a printer, with any text that a person may have configured."""

import os
from pathlib import Path

import pytest

from drivers.safety import cut_mains


def test_command_receives_the_name_of_the_printer_and_runs_without_a_shell(tmp_path: Path):
    record_path = tmp_path / "seen"
    relay = tmp_path / "relay"
    relay.write_text(f'#!/bin/sh\nprintf "%s|" "$@" > {record_path}\n')
    relay.chmod(0o700)
    outcome = cut_mains(f"{relay} {{printer}} 'a b' $(touch${{IFS}}x) ; &", "um2-01")
    assert outcome == "power_off_cmd cut its mains"
    assert record_path.read_text() == "um2-01|a b|$(touch${IFS}x)|;|&|"


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("", "could not be run"),
        ("'", "could not be run"),
        ("a\0b", "could not be run"),
        (f"{os.devnull}/none", "could not be run"),
        ("false", "failed (1)"),
        ("sh -c 'echo first >&2; echo stuck >&2; exit 3'", "failed (stuck)"),
        ("sleep 60", "did not end"),
        ("yes", "did not end"),
        ("sh -c 'exec sleep 2 & exec sleep 60'", "did not end"),
    ],
)
def test_every_failure_is_reported_and_needs_a_person(command: str, reason: str):
    outcome = cut_mains(command, "um2-01", timeout_s=0.2)
    assert reason in outcome and outcome.endswith("switch it off by hand")
