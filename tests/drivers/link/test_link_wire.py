"""Link and emulated firmware over wires that split, delay, lose, change and double bytes."""

import math
import random
from collections import deque

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bench.printing.soak import print_over_noisy_wire
from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.emulator.hardware.noise import Noise
from drivers.errors import Fault
from drivers.firmware import ULTIMAKER2
from drivers.gcode import remove_frame
from drivers.link import Link, LinkFault, Phase
from drivers.printers import PROFILES
from printers.link_bench import pass_to_link

NAMED_FAULTS = {Fault.NO_ANSWER, Fault.NOISY_LINE, Fault.REBOOT}


class RecordingFirmware(EmulatedFirmware):
    """Board that records the numbered lines that it accepted."""

    def __init__(self, faults: Faults, seed: int) -> None:
        self.accepted_lines: list[tuple[int, bytes]] = []
        super().__init__(PROFILES["ultimaker2_plus"], faults, random.Random(seed), 0.0)

    def _read_plain_move(self) -> bool:
        return False

    def _accept_line(self, line: bytes) -> None:
        old_number = self._last_number
        super()._accept_line(line)
        if self._last_number != old_number:
            self.accepted_lines.append((self._last_number, remove_frame(line)))


class Wire:
    """One direction of a wire, which delays each piece of the data at random and keeps their order."""

    def __init__(self, piece_bytes: int, max_delay_s: float, rng: random.Random) -> None:
        self.piece_bytes, self.max_delay_s, self.rng = piece_bytes, max_delay_s, rng
        self.in_transit: deque[tuple[float, bytes]] = deque()
        self.last_s = 0.0

    def put(self, data: bytes, now_s: float) -> None:
        for index in range(0, len(data), self.piece_bytes):
            self.last_s = max(self.last_s, now_s + self.rng.random() * self.max_delay_s)
            self.in_transit.append((self.last_s, data[index : index + self.piece_bytes]))

    def compute_due_s(self) -> float:
        return self.in_transit[0][0] if self.in_transit else math.inf

    def take(self, now_s: float) -> bytes:
        data = b""
        while self.in_transit and self.in_transit[0][0] <= now_s:
            data += self.in_transit.popleft()[1]
        return data


def print_program(
    program: list[bytes], faults: Faults, piece_bytes: int, max_delay_s: float, seed: int
) -> tuple[RecordingFirmware, Link, list[Fault]]:
    """Stream a program until it ends or the link gives up; return the board, the link and the faults."""
    rng = random.Random(seed)
    firmware, link = RecordingFirmware(faults, seed), Link(ULTIMAKER2)
    to_board, to_host = Wire(piece_bytes, max_delay_s, rng), Wire(piece_bytes, max_delay_s, rng)
    now_s, is_connected, link_faults = 0.0, False, []
    link.on_opened(now_s)
    for _ in range(100_000):
        to_board.put(link.take(), now_s)
        due_s = min(
            firmware.compute_deadline_s(), link.deadline_s, to_board.compute_due_s(), to_host.compute_due_s()
        )
        now_s = max(now_s, min(due_s, now_s + 1000.0)) + 1e-4
        to_host.put(firmware.feed(to_board.take(now_s), now_s), now_s)
        line, events = pass_to_link(link, to_host.take(now_s), now_s)
        to_board.put(line, now_s)
        events = [*events, *link.tick(now_s)]
        link_faults += [event.fault for event in events if isinstance(event, LinkFault)]
        if not is_connected and link.phase is Phase.LIVE:
            is_connected = True
            link.stream(now_s, lambda a, b: program[a:b], 0, len(program))
        elif (is_connected and link.is_drained) or link_faults:
            return firmware, link, link_faults
    raise AssertionError("the stream does not end")


@given(
    count=st.integers(1, 120),
    noise=st.sampled_from([0.0, 0.0002, 0.001, 0.01]),
    loss_share=st.sampled_from([0.0, 0.0002, 0.002]),
    doubling_share=st.sampled_from([0.0, 0.0002, 0.002]),
    piece_bytes=st.sampled_from([1, 2, 7, 1000]),
    max_delay_s=st.sampled_from([0.0, 0.01, 0.5, 12.0]),
    seed=st.integers(0, 2**32),
)
# The noise changes a byte to a second space.
@example(
    count=120,
    noise=0.0002,
    loss_share=0.0002,
    doubling_share=0.002,
    piece_bytes=7,
    max_delay_s=0.0,
    seed=580706,
)
@settings(max_examples=80, deadline=None)
def test_noisy_wire_executes_lines_once_unaltered_or_ends_in_a_named_fault(
    count: int,
    noise: float,
    loss_share: float,
    doubling_share: float,
    piece_bytes: int,
    max_delay_s: float,
    seed: int,
):
    moves = [b"G1 X%d.%02d Y%d E%d" % (i % 200, i % 97, i % 190, i) for i in range(1, count)]
    program = [b"M302 S0", *moves, *[b"M400"] * 3]
    firmware, link, link_faults = print_program(
        program, Faults(noise=noise, lost=loss_share, doubled=doubling_share), piece_bytes, max_delay_s, seed
    )
    numbers = [number for number, _ in firmware.accepted_lines]
    assert numbers == list(range(1, len(numbers) + 1))
    altered_count = sum(
        body != line for (_, body), line in zip(firmware.accepted_lines, program, strict=False)
    )
    assert altered_count == (firmware.noise.altered_line_count if firmware.noise is not None else 0)
    if link_faults:
        assert set(link_faults) <= NAMED_FAULTS
    else:
        assert len(numbers) >= count
        assert link.streamed_line_count == len(program)


def test_checksum_collision_is_counted():
    """Swap two digits, which keeps the XOR: the firmware accepts the line, and the emulator counts it."""
    firmware = RecordingFirmware(Faults(noise=1e-9), 0)
    assert firmware.noise is not None
    firmware.feed(b"", 10.0)

    class SwappedDigits(Noise):
        def carry(self, data: bytes) -> bytes:
            return data.replace(b"X12", b"X21")

    firmware.noise.__class__ = SwappedDigits
    link = Link(ULTIMAKER2)
    link.on_opened(10.0)
    firmware.reset(10.0)
    now_s = 10.0
    for _ in range(200):
        now_s = max(now_s + 0.01, min(firmware.compute_deadline_s(), link.deadline_s, now_s + 1.0))
        answer = firmware.feed(link.take(), now_s)
        link.receive(answer, now_s)
        link.tick(now_s)
        if link.phase is Phase.LIVE and not firmware.accepted_lines and link.is_drained:
            link.send(now_s, b"G1 X12", b"G1 X10")
    assert [body for _, body in firmware.accepted_lines] == [b"G1 X21", b"G1 X10"]
    assert firmware.noise.altered_line_count == 1


@pytest.mark.parametrize("seed", range(3))
def test_long_print_over_a_slightly_noisy_wire_is_exact(seed: int):
    outcome = print_over_noisy_wire(20_000, 0.00005, seed)
    assert outcome.exact and outcome.altered == 0
    assert outcome.repeated > 10


@pytest.mark.parametrize("seed", range(5))
def test_link_gives_up_on_a_very_noisy_wire(seed: int):
    outcome = print_over_noisy_wire(20_000, 0.001, seed)
    assert outcome.fault == Fault.NOISY_LINE
