"""Faults that a URL may request, and the transfer time of the wire."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults, FaultSampler, parse_faults, parse_url
from drivers.emulator.hardware.wire import Wire
from drivers.errors import PortError
from drivers.printers import PROFILES


def test_plain_url_has_no_faults() -> None:
    url = parse_url("sim://ultimaker2_extended_plus")
    assert url.profile.model == "ultimaker2_extended_plus"
    assert url.faults == Faults() and url.seed == 0 and not url.faults.affects_lines


def test_faults_have_two_notations() -> None:
    plain_url = parse_url("sim://ultimaker2_plus?checksum=0.01&dead_bed=1&reset_after=500&seed=7")
    named_url = parse_url("sim://ultimaker2_plus?fault=checksum:0.01,dead_bed&fault=reset_after:500&seed=7")
    assert plain_url.faults == named_url.faults == Faults(checksum=0.01, dead_bed=True, reset_after=500)
    assert plain_url.seed == named_url.seed == 7
    assert parse_faults(plain_url.fault_arguments) == plain_url.faults
    assert parse_faults(named_url.fault_arguments) == plain_url.faults


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("/dev/ttyUSB0", "not an emulator's url"),
        (
            "sim://prusa_mk4",
            f"no printer model 'prusa_mk4'; use one of {', '.join(sorted(PROFILES))}",
        ),
        ("sim://ultimaker2_plus?fire=1", "no fault 'fire'; use one of advanced_ok"),
        ("sim://ultimaker2_plus?checksum=often", "checksum needs a number, not 'often'"),
        ("sim://ultimaker2_plus?checksum=2", "checksum needs a probability from 0 to 1, not '2'"),
        ("sim://ultimaker2_plus?reset_after=1.5", "reset_after needs a whole number from 0, not '1.5'"),
        ("sim://ultimaker2_plus?seed=x", "seed 'x' is not a whole number"),
    ],
)
def test_error_for_an_invalid_url_names_the_mistake_and_the_choices(url: str, message: str) -> None:
    with pytest.raises(PortError, match=r"^[^\n]*$") as error:
        parse_url(url)
    assert message in str(error.value)


@given(st.binary(min_size=1, max_size=95), st.integers(0, 1000))
@settings(deadline=None)
def test_disturbed_line_differs_in_one_byte(line: bytes, seed: int) -> None:
    disturbed_line = FaultSampler(Faults(checksum=1.0), random.Random(seed)).disturb_line(line)
    assert len(disturbed_line) == len(line)
    assert sum(a != b for a, b in zip(line, disturbed_line, strict=True)) == 1


def test_bytes_are_delivered_in_order_at_the_baud_rate() -> None:
    wire, byte_s = Wire(250_000), 40e-6
    wire.put(b"x" * 100, 10.0)
    wire.put(b"y" * 50, 10.001)
    assert wire.compute_due_s() == pytest.approx(10.0 + 100 * byte_s)
    assert wire.take(10.0039) == b""
    assert wire.take(10.0041) == b"x" * 100
    assert wire.compute_due_s() == pytest.approx(10.0 + 150 * byte_s)
    assert wire.take(11.0) == b"y" * 50
    wire.put(b"z", 12.0)
    wire.clear()
    assert wire.take(20.0) == b""
