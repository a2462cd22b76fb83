"""Frames of lines, and lines with one flipped bit that the firmware accepts."""

import random
from functools import reduce
from operator import xor

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.emulator.firmware.listener import Phase
from drivers.emulator.firmware.machine import read_value
from drivers.firmware import ULTIMAKER2
from drivers.gcode import add_frame, add_frames, compute_checksum, remove_frame
from drivers.gcode.frame import MAX_FRAME_BYTES, compute_running_checksums
from drivers.gcode.line import match_plain_move
from drivers.printers import PROFILES

LETTERS = [bytes([letter]) for letter in b"ABCDEFGHIJKLMOPQRSTUVWXYZ"]  # no N, the line's number
COLLIDING_MOVE = b"G1 X10 Y112.30 E4.5"


class FirmwareReceiver(EmulatedFirmware):
    """Emulated firmware that returns the commands instead of executing them."""

    def __init__(self) -> None:
        super().__init__(PROFILES["ultimaker2_plus"], Faults(), random.Random(0), 0.0)
        self.phase = Phase.RUNNING

    def take(self, number: int, data: bytes) -> list[bytes]:
        """Return the lines of `data` that the firmware executes if line `number` is the next."""
        self._drop_input()
        self._last_number = number - 1
        self._receiver.put(data)
        self._get_command()
        return [line for line in self._buffer if any(letter in line for letter in b"GMT")]


RECEIVER = FirmwareReceiver()


def read_values(line: bytes) -> dict[bytes, float]:
    """Return the values of a line's letters, except for a J without a number.

    A flipped newline adds such a J, which is the default of an arc.
    """
    results = {letter: read_value(line, letter) for letter in LETTERS}
    return {letter: v for letter, v in results.items() if v is not None and (letter, v) != (b"J", 0.0)}


def list_flipped_frames(data: bytes) -> list[bytes]:
    return [
        data[:index] + bytes([data[index] ^ 1 << bit]) + data[index + 1 :]
        for index in range(len(data))
        for bit in range(8)
    ]


@st.composite
def draw_numbered_moves(draw: st.DrawFn, letters: bytes = b"FXYE") -> tuple[int, bytes]:
    """Draw a line number and a move in which some decimals equal the checksum of the bytes before them."""
    number = draw(st.integers(1, 9_999_999))
    command = b"G1"
    for letter in draw(st.lists(st.sampled_from(letters), min_size=1, unique=True).map(sorted)):
        command += b" %c%d." % (letter, draw(st.integers(-300, 99_999)))
        collision = compute_checksum(b"N%d %b" % (number, command[:-1]))
        blank = collision ^ ord(" ")
        decimals = st.from_regex(rb"\A[0-9]{0,6}\Z")
        checksums = st.sampled_from(
            [b"%d" % collision, b"%03d" % collision, b"%06d" % collision, b"%d" % blank]
        )
        command += draw(checksums | decimals)
    return number, command


@given(draw_numbered_moves())
@example((4, COLLIDING_MOVE))
@settings(max_examples=100, deadline=None)
def test_flipped_bit_is_never_accepted_as_another_line(line):
    number, command = line
    frame = add_frame(number, command)
    assert [read_values(executed_line) for executed_line in RECEIVER.take(number, frame)] == [
        read_values(command)
    ]
    for data in list_flipped_frames(frame):
        for executed_line in RECEIVER.take(number, data + ULTIMAKER2.last_line_query):
            assert read_values(executed_line) == read_values(command), (data, executed_line)


@pytest.mark.parametrize(
    "command",
    [b"M110", b"M105", b"G28", b"M104 S210", b"M109 S0", b"M140 S60", b"G92 E0", b"M106 S127.5", b"M401",
     b"G2 X10.5 Y0.25 I5.125 J0 E1", b"M220 S100", b"M84", b"G4 P500", b"M85 S120", b"M82"],
)  # fmt: skip
def test_flipped_bit_is_never_accepted_in_lines_of_a_session(command):
    for number in (0, 1, 38, 999_999):
        for data in list_flipped_frames(add_frame(number, command)):
            for line in RECEIVER.take(number, data + ULTIMAKER2.last_line_query):
                assert read_values(line) == read_values(command), (data, line)


@given(draw_numbered_moves(b"EFIJRXYZ"))
@settings(deadline=None)
def test_frame_contains_its_command_and_fits_a_line(line):
    number, command = line
    assume(len(command) <= ULTIMAKER2.max_command_bytes)
    frame = add_frame(number, command)
    assert remove_frame(frame) == command
    text, _, checksum_text = frame.removesuffix(b"\n").rpartition(b"*")
    assert text.split() == [b"N%d" % number, *command.split()]
    assert int(checksum_text) == compute_checksum(text)
    assert len(frame) <= MAX_FRAME_BYTES + 1


def test_blank_is_inserted_only_where_needed():
    assert compute_checksum(b"N4 G1 X10 Y112") == 30
    assert add_frame(4, COLLIDING_MOVE).startswith(b"N4 G1 X10  Y112.30 E4.5*")
    assert add_frame(5, COLLIDING_MOVE).startswith(b"N5 G1 X10 Y112.30 E4.5*")


@given(st.integers(1, 60_000), st.integers(0, 199_999), st.integers(0, 10**7))
def test_few_lines_need_a_blank(number, x_um, e_10nm):
    command = b"G1 X%.3f E%.5f" % (x_um / 1000, e_10nm / 1e5)
    assert match_plain_move(command)
    line = b"N%d %b" % (number, command)
    plain_line = b"%b*%d\n" % (line, compute_checksum(line))
    collides = any(
        compute_checksum(line[:index]) == int(line[index + 1 :].split()[0])
        for index, byte in enumerate(line)
        if byte == ord(".")
    )
    assert (add_frame(number, command) == plain_line) is not collides


def test_line_without_room_for_a_blank_keeps_its_length():
    command = COLLIDING_MOVE + b" " + b"S" * (ULTIMAKER2.max_command_bytes - len(COLLIDING_MOVE) - 1)
    assert len(add_frame(4, command)) <= MAX_FRAME_BYTES + 1
    longest_command = command + b"S" * (MAX_FRAME_BYTES - len(b"N4 *255") - len(command))
    assert len(add_frame(4, longest_command)) <= MAX_FRAME_BYTES + 1


@given(st.binary(min_size=1, max_size=128))
def test_running_checksums_match_each_prefix(line):
    assert list(compute_running_checksums(line)) == [
        reduce(xor, line[: index + 1]) for index in range(len(line))
    ]


@given(st.integers(0, 9_999_000), st.lists(draw_numbered_moves().map(lambda line: line[1]), max_size=30))
@example(3, [b"G1 X1.5", COLLIDING_MOVE, b"M117 1. *2.30 *", b"M105", b"G1 Y.0000000000 E1.1234567"])
def test_lines_framed_together_equal_lines_framed_one_by_one(number, commands):
    frames = [add_frame(index, command) for index, command in enumerate(commands, number)]
    assert add_frames(number, commands) == frames


@given(st.integers(1, 99_999), st.data())
def test_blank_is_inserted_in_a_line_among_many(number, data):
    """Use lines whose decimals equal the checksum of the bytes before them."""
    commands = []
    for index in range(number, number + data.draw(st.integers(1, 8))):
        command = b"G1 X10 Y%d" % data.draw(st.integers(0, 200))
        commands.append(b"%b.%d E4.5" % (command, compute_checksum(b"N%d %b" % (index, command))))
    frames = add_frames(number, commands)
    assert all(b"  Y" in frame for frame in frames)
    assert [remove_frame(frame) for frame in frames] == commands
