"""Streams on one connection: bytes arrive once and in order for any division into packets."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import MessageError
from drivers.host.mux import (
    FRAME_BYTES,
    MAX_PAYLOAD_BYTES,
    WINDOW_BYTES,
    DataReceived,
    Frame,
    FrameKind,
    FrameReader,
    Message,
    Mux,
    StreamClosed,
    StreamOpened,
)

FRAMES = st.builds(
    Frame, st.sampled_from(FrameKind), st.integers(0, 2**32 - 1), st.binary(max_size=300)
)  # fmt: skip


def split_bytes(data: bytes, piece_sizes: list[int]) -> list[bytes]:
    """Split bytes into pieces whose lengths are taken from `piece_sizes` in turn."""
    pieces, offset, piece_count = [], 0, 0
    while offset < len(data):
        size = piece_sizes[piece_count % len(piece_sizes)] if piece_sizes else len(data)
        pieces.append(data[offset : offset + size])
        offset, piece_count = offset + size, piece_count + 1
    return pieces


def transfer_bytes(source: Mux, target: Mux, piece_sizes: list[int]) -> list[object]:
    """Transfer all bytes that one end can send now to the other; return the events of the other end."""
    events: list[object] = []
    while data := source.take():
        for piece in split_bytes(data, piece_sizes):
            events += target.receive(piece)
    return events


@given(st.lists(FRAMES, max_size=20), st.lists(st.integers(1, 400), max_size=5))
def test_frames_are_the_same_after_any_split(frames, piece_sizes):
    reader, data = FrameReader(), b"".join(frame.encode() for frame in frames)
    assert [frame for piece in split_bytes(data, piece_sizes) for frame in reader.feed(piece)] == frames


PATTERN = bytes(range(251)) * 1000
ACTIONS = st.sampled_from(["to host", "to daemon", "consume"])
STEPS = st.lists(st.tuples(st.integers(0, 2), ACTIONS, st.integers(0, 200_000)), max_size=8)


@settings(max_examples=25, deadline=None)
@given(STEPS, st.lists(st.integers(1, 50_000), min_size=1, max_size=4))
def test_bytes_of_each_stream_arrive_once_and_in_order(steps, piece_sizes):
    daemon, host = Mux(), Mux()
    streams = [daemon.open(f"um2-{number}") for number in range(3)]
    assert [
        event for event in transfer_bytes(daemon, host, piece_sizes) if isinstance(event, StreamOpened)
    ] == [StreamOpened(stream, f"um2-{number}") for number, stream in enumerate(streams)]
    directions = {"to host": (daemon, host), "to daemon": (host, daemon)}
    sent_data = {(direction, s): b"" for direction in directions for s in streams}
    received_data = dict.fromkeys(sent_data, b"")

    def transfer_all_bytes() -> None:
        for direction, (source, target) in directions.items():
            for event in transfer_bytes(source, target, piece_sizes):
                assert isinstance(event, DataReceived)
                received_data[direction, event.number] += event.data

    for stream_number, action, size in steps:
        stream = streams[stream_number]
        if action == "consume":
            for direction, (_, target) in directions.items():
                target.consume(stream, min(size, len(received_data[direction, stream])))
        else:
            piece = PATTERN[len(sent_data[action, stream]) % 251 :][:size]
            directions[action][0].write(stream, piece)
            sent_data[action, stream] += piece
        transfer_all_bytes()
        assert all(sent_data[key].startswith(received_data[key]) for key in sent_data)
    for _ in range(1 + sum(size for _, _, size in steps) // (WINDOW_BYTES // 4)):
        for _, target in directions.values():
            for stream in streams:
                target.consume(stream, WINDOW_BYTES)
        transfer_all_bytes()
    assert received_data == sent_data


def test_unread_stream_stops_and_the_others_continue():
    daemon, host = Mux(), Mux()
    slow_stream, fast_stream = daemon.open("slow"), daemon.open("fast")
    list(transfer_bytes(daemon, host, []))
    host.write(slow_stream, b"s" * (WINDOW_BYTES + 1000))
    transfer_bytes(host, daemon, [])
    assert host.count_unsent_bytes(slow_stream) == 1000
    host.write(fast_stream, b"f" * 100)
    assert transfer_bytes(host, daemon, []) == [DataReceived(fast_stream, b"f" * 100)]
    daemon.consume(slow_stream, WINDOW_BYTES)
    transfer_bytes(daemon, host, [])
    assert transfer_bytes(host, daemon, []) == [DataReceived(slow_stream, b"s" * 1000)]


def test_streams_take_turns_so_that_a_short_one_does_not_wait_for_a_long_one():
    daemon, host = Mux(), Mux()
    long_stream, short_stream = daemon.open("long"), daemon.open("short")
    daemon.write(long_stream, b"l" * WINDOW_BYTES)
    daemon.write(short_stream, b"s")
    events = list(host.receive(daemon.take(3 * FRAME_BYTES)))
    assert DataReceived(short_stream, b"s") in events


def test_stream_closes_after_its_bytes_and_late_bytes_are_dropped():
    daemon, host = Mux(), Mux()
    stream = daemon.open("a")
    transfer_bytes(daemon, host, [])
    host.write(stream, b"last")
    host.close(stream, "the agent has ended")
    daemon.write(stream, b"too late")
    assert transfer_bytes(host, daemon, []) == [
        DataReceived(stream, b"last"),
        StreamClosed(stream, "the agent has ended"),
    ]
    assert transfer_bytes(daemon, host, []) == []
    assert transfer_bytes(host, daemon, []) == []
    assert daemon.open("a") != stream


def test_close_of_a_full_stream_waits_for_its_bytes():
    daemon, host = Mux(), Mux()
    stream = daemon.open("a")
    transfer_bytes(daemon, host, [])
    host.write(stream, b"x" * (WINDOW_BYTES + 1))
    host.close(stream)
    assert not any(isinstance(event, StreamClosed) for event in transfer_bytes(host, daemon, []))
    daemon.consume(stream, WINDOW_BYTES)
    transfer_bytes(daemon, host, [])
    assert transfer_bytes(host, daemon, []) == [DataReceived(stream, b"x"), StreamClosed(stream, "")]


def test_messages_overtake_waiting_data():
    daemon, host = Mux(), Mux()
    stream = daemon.open("a")
    daemon.write(stream, b"x" * 100_000)
    daemon.send_message(b"{}")
    assert list(host.receive(daemon.take(1))) == [StreamOpened(stream, "a")]
    assert list(host.receive(daemon.take(1))) == [Message(b"{}")]


@pytest.mark.parametrize(
    "data",
    [
        b"Welcome to pc-b",
        Frame(FrameKind.OPEN, 1, b"a").encode() * 2,
        Frame(FrameKind.OPEN, 1).encode() + Frame(FrameKind.CREDIT, 1, b"1").encode(),
        Frame(FrameKind.OPEN, 1).encode() + Frame(FrameKind.DATA, 1, bytes(FRAME_BYTES)).encode() * 17,
        Frame(FrameKind.DATA, 1).encode()[:5] + (MAX_PAYLOAD_BYTES + 1).to_bytes(4, "big"),
    ],
)
def test_bytes_of_another_protocol_are_an_error(data):
    with pytest.raises(MessageError):
        list(Mux().receive(data))


def test_sending_a_message_that_the_other_end_would_refuse_is_an_error():
    with pytest.raises(MessageError):
        Mux().send_message(bytes(MAX_PAYLOAD_BYTES + 1))
