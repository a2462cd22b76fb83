"""Tables of the lifecycles: complete, and consistent with the rules."""

from typing import get_args

import pytest

from farm.state import events as ev
from farm.state.lifecycles import FARM_WIDE_EVENTS, LIFECYCLES, NO_STATE


def test_every_event_has_a_subject():
    handled_events = set().union(*(lifecycle.event_kinds for lifecycle in LIFECYCLES)) | FARM_WIDE_EVENTS
    assert handled_events == set(get_args(ev.AnyEvent))


@pytest.mark.parametrize("lifecycle", LIFECYCLES, ids=lambda item: item.entity_name)
def test_every_state_is_reachable(lifecycle):
    rows = [*lifecycle.transitions, *lifecycle.consequences]
    reached_states = {NO_STATE}
    while True:
        new_states = (
            set().union(*(row.end_states or () for row in rows if row.start_states & reached_states))
            - reached_states
        )
        if not new_states:
            break
        reached_states |= new_states
    assert reached_states - {NO_STATE} == set(lifecycle.states)


@pytest.mark.parametrize("lifecycle", LIFECYCLES, ids=lambda item: item.entity_name)
def test_every_event_about_an_entity_names_it(lifecycle):
    assert all(lifecycle.key_field in kind.model_fields for kind in lifecycle.event_kinds)
