"""Plan of the faults in a night on several hosts."""

import random
from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from bench.host_night import MAX_ABSENCE_S, MIN_ABSENCE_S, HostFault, plan_faults

SPANS_S = [(300.0, 8000.0), (12000.0, 28000.0)]


@given(st.integers(0, 30), st.integers())
def test_faults_of_all_kinds_are_planned_in_order_within_the_spans(count, seed):
    faults = plan_faults(count, ["pc-1", "pc-2"], SPANS_S, random.Random(seed))
    kinds = Counter(fault.kind for fault in faults)
    assert len(faults) == count and faults == sorted(faults, key=lambda fault: fault.at_s)
    assert max(kinds.values(), default=0) - min((kinds[kind] for kind in HostFault), default=0) <= 1
    assert all(any(begin_s <= fault.at_s <= end_s for begin_s, end_s in SPANS_S) for fault in faults)
    assert all(MIN_ABSENCE_S <= fault.duration_s <= MAX_ABSENCE_S for fault in faults)
    assert faults == plan_faults(count, ["pc-1", "pc-2"], SPANS_S, random.Random(seed))
