"""The command that takes a printer's mains away, with whatever a person may have written there."""

import os
from pathlib import Path

import pytest

from drivers.safety import mains


def test_a_relay_is_told_which_printer_and_no_shell_sees_the_words(tmp_path: Path):
    seen = tmp_path / "seen"
    relay = tmp_path / "relay"
    relay.write_text(f'#!/bin/sh\nprintf "%s|" "$@" > {seen}\n')
    relay.chmod(0o700)
    said = mains.cut(f"{relay} {{printer}} 'a b' $(touch${{IFS}}x) ; &", "um2-01")
    assert said == "power_off_cmd took its mains away"
    assert seen.read_text() == "um2-01|a b|$(touch${IFS}x)|;|&|"


@pytest.mark.parametrize(
    ("command", "why"),
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
def test_whatever_goes_wrong_is_said_and_a_person_is_asked(command: str, why: str):
    said = mains.cut(command, "um2-01", patience_s=0.2)
    assert why in said and said.endswith("switch it off by hand")
