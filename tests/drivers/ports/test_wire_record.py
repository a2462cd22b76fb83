"""Record of the last bytes on a port."""

from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.messages import Reply, WireLine
from drivers.ports import WireRecord
from drivers.ports.wire_record import split_lines


def test_record_is_bounded_in_number_and_length():
    record = WireRecord(lambda: 0.0)
    for _ in range(10_000):
        record.record(True, b"x" * 5000 + b"\n")
        record.record(False, b"ok\n")
    assert len(record.list_lines()) <= 400
    assert max(len(line.text) for line in record.list_lines()) == 200


@pytest.mark.parametrize("noise", [b"\n", b"ok\n", b"\x00", b"\x00" * 300 + b"\n"])
def test_noise_fits_into_a_message(noise):
    """Limit the length, because a longer line would end the daemon's connection and delay the serial loop."""
    record = WireRecord(lambda: 0.0)
    for _ in range(1000):
        record.record(False, (noise * 1000)[:4096])
    lines = tuple(WireLine(at_s=line.at_s, sent=line.sent, text=line.text) for line in record.list_lines())
    assert 0 < len(lines) <= 400
    assert len(Reply(id=1, lines=lines).model_dump_json()) < 2**19


def test_long_reads_keep_all_lines():
    record = WireRecord(lambda: 0.0)
    record.record(False, b"echo:" + b"x" * 600 + b"\nok\n")
    assert [line.text for line in record.list_lines()][1:] == ["ok"]


def test_bytes_that_are_not_text_are_shown_as_escapes():
    record = WireRecord(lambda: 0.0)
    record.record(True, b"\x00\x1b[31m\xff<b>\n")
    assert [line.text for line in record.list_lines()] == ["\\x00\\x1b[31m\\xff<b>"]


@given(st.lists(st.tuples(st.booleans(), st.text("ab \n", max_size=12).map(str.encode)), max_size=30))
def test_no_byte_of_a_line_is_lost(pieces):
    lines = list(split_lines((float(n), *piece) for n, piece in enumerate(pieces)))
    groups = [
        (is_sent, b"".join(data for _, data in group))
        for is_sent, group in groupby(pieces, key=lambda p: p[0])
    ]
    expected_lines = [(is_sent, line.decode()) for is_sent, data in groups for line in data.split(b"\n")]
    assert [(line.sent, line.text) for line in lines if line.text] == [
        (is_sent, text) for is_sent, text in expected_lines if text
    ]
    assert [line.at_s for line in lines] == sorted(line.at_s for line in lines)
