"""Forecast of the nights until the disk is full."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.state.retention import DiskUse, average_day_bytes, estimate_nights_until_full

GB = 1e9


@pytest.mark.parametrize(
    ("use", "nights"),
    [
        (DiskUse(10 * GB, 5 * GB, 0.0, 1 * GB), 9.5),  # nothing to prune before 50 GB
        (DiskUse(10 * GB, 49 * GB, 40 * GB, 1 * GB), 49.5),  # after a night each is paid by an old one
        (DiskUse(10 * GB, 49 * GB, 0.0, 1 * GB), 9.5),  # everything is needed
        (DiskUse(0.4 * GB, 49 * GB, 40 * GB, 1 * GB), 0.0),
        (DiskUse(2 * GB, 1 * GB, 1 * GB, 1 * GB), 1.5),  # full before the limit is reached
        (DiskUse(10 * GB, 0.0, 0.0, 0.0), math.inf),
    ],
)
def test_nights_until_full_follow_from_stored_events(use, nights):
    assert estimate_nights_until_full(use, 50 * GB, 0.5 * GB) == pytest.approx(nights)


_bytes = st.floats(0, 1e13)


@given(free=_bytes, stored=_bytes, prunable=_bytes, day=st.floats(1, 1e12), most=_bytes, more=_bytes)
def test_more_free_space_is_never_full_earlier(free, stored, prunable, day, most, more):
    def nights(**changes):
        use = DiskUse(
            **(
                {"free_bytes": free, "stored_bytes": stored, "prunable_bytes": prunable, "day_bytes": day}
                | changes
            )
        )
        return estimate_nights_until_full(use, most, 0.5 * GB)

    slack = 1 + 1e-9
    assert nights(free_bytes=free + more) * slack >= nights()
    assert nights(prunable_bytes=prunable + more) * slack >= nights()
    assert nights(day_bytes=day + more) <= nights() * slack


def test_busy_weekend_outweighs_a_quiet_week():
    quiet = [(6.5, 700), (5.5, 0)]
    assert average_day_bytes(quiet) == pytest.approx(700 / 6.5)
    assert average_day_bytes([*quiet, (1.0, 4000)]) == 2000.0
    assert average_day_bytes([(30.0, 10**9)]) == 0.0
    assert average_day_bytes([(0.1, 500)]) == 500.0  # a new farm
    assert average_day_bytes([]) == 0.0
