"""Forecast of the nights until the disk is full."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.state.retention import DiskUse, compute_daily_bytes, estimate_nights_until_full

GB = 1e9


@pytest.mark.parametrize(
    ("disk_use", "nights"),
    [
        (DiskUse(10 * GB, 5 * GB, 0.0, 1 * GB), 9.5),  # nothing to prune before 50 GB
        # After one night each new job replaces an old one.
        (
            DiskUse(10 * GB, 49 * GB, 40 * GB, 1 * GB),
            49.5,
        ),
        (DiskUse(10 * GB, 49 * GB, 0.0, 1 * GB), 9.5),  # all files are needed
        (DiskUse(0.4 * GB, 49 * GB, 40 * GB, 1 * GB), 0.0),
        (DiskUse(2 * GB, 1 * GB, 1 * GB, 1 * GB), 1.5),  # full before the limit is reached
        (DiskUse(10 * GB, 0.0, 0.0, 0.0), math.inf),
    ],
)
def test_nights_until_full_follow_from_the_use_of_the_disk(disk_use, nights):
    assert estimate_nights_until_full(disk_use, 50 * GB, 0.5 * GB) == pytest.approx(nights)


_bytes = st.floats(0, 1e13)


@given(
    free_bytes=_bytes,
    stored_bytes=_bytes,
    prunable_bytes=_bytes,
    daily_bytes=st.floats(1, 1e12),
    max_bytes=_bytes,
    more_bytes=_bytes,
)
def test_more_free_space_is_never_full_earlier(
    free_bytes, stored_bytes, prunable_bytes, daily_bytes, max_bytes, more_bytes
):
    def forecast_nights(**changes):
        disk_use = DiskUse(
            **(
                {
                    "free_bytes": free_bytes,
                    "stored_bytes": stored_bytes,
                    "prunable_bytes": prunable_bytes,
                    "daily_bytes": daily_bytes,
                }
                | changes
            )
        )
        return estimate_nights_until_full(disk_use, max_bytes, 0.5 * GB)

    slack = 1 + 1e-9
    assert forecast_nights(free_bytes=free_bytes + more_bytes) * slack >= forecast_nights()
    assert forecast_nights(prunable_bytes=prunable_bytes + more_bytes) * slack >= forecast_nights()
    assert forecast_nights(daily_bytes=daily_bytes + more_bytes) <= forecast_nights() * slack


def test_busy_weekend_outweighs_a_quiet_week():
    quiet_days = [(6.5, 700), (5.5, 0)]
    assert compute_daily_bytes(quiet_days) == pytest.approx(700 / 6.5)
    assert compute_daily_bytes([*quiet_days, (1.0, 4000)]) == 2000.0
    assert compute_daily_bytes([(30.0, 10**9)]) == 0.0
    assert compute_daily_bytes([(0.1, 500)]) == 500.0  # a new farm
    assert compute_daily_bytes([]) == 0.0
