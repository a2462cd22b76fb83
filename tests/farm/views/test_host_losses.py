"""Lost hosts: one task, and one notice for all hosts lost at the same time."""

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events
from farm.config import Fleet
from farm.model import Bed, HostLoss
from farm.paths import StateFolder
from farm.state import events as ev
from farm.state.books import Books
from farm.state.outage import OUTAGE_WINDOW_S
from farm.state.storage.store import Store
from farm.views import ViewContext, list_due_notices, list_tasks
from farm.views.host_losses import describe_lost_hosts

PRINTER_MODEL = "ultimaker2_plus"
LATER_S = 1e6


def make_fleet(hosts, printers_per_host=2):
    rows = [
        {"name": f"{host}-{index}", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}", "host": host}
        for host in hosts
        for index in range(1, printers_per_host + 1)
    ]
    return Fleet.model_validate({"printers": rows})


def make_fleet_books(fleet):
    added_events = (ev.PrinterAdded(at_s=0.0, printer=name, bed=Bed.CLEAR) for name in fleet.names)
    return apply_events(Books(), *added_events)[0]


def list_printers(fleet, host):
    return tuple(section.name for section in fleet.printers if section.host == host)


def make_loss(fleet, host, at_s):
    return ev.HostLost(at_s=at_s, host=host, printers=list_printers(fleet, host), reason="time-out")


def make_reconnection(fleet, host, at_s):
    return ev.HostConnected(at_s=at_s, host=host, printers=list_printers(fleet, host))


def list_host_tasks(fleet, books):
    tasks = list_tasks(ViewContext(fleet, books, {}, StateFolder(Path("state")), LATER_S))
    return [task for task in tasks if task.code == "host"]


def test_lost_host_is_one_task_and_one_notice_until_it_is_back():
    fleet = make_fleet(["pc-a", "pc-b"], printers_per_host=20)
    books, _ = apply_events(make_fleet_books(fleet), make_loss(fleet, "pc-b", 100.0))
    sentence = (
        "pc-b with 20 printers does not answer (time-out): prints continue there without the farm; "
        "check its power and its network"
    )
    (task,) = list_host_tasks(fleet, books)
    assert (task.text, task.printers) == (f"{sentence} (`farm hosts`)", list(list_printers(fleet, "pc-b")))
    (notice,) = list_due_notices(books, LATER_S, 0.0, ())
    assert notice.text == sentence
    assert list_due_notices(books, LATER_S, 0.0, {notice.key}) == []
    books, _ = apply_events(books, make_reconnection(fleet, "pc-b", 200.0))
    assert list_host_tasks(fleet, books) == [] == list_due_notices(books, LATER_S, 0.0, ())
    books, _ = apply_events(books, make_loss(fleet, "pc-b", 300.0))
    assert [due.key for due in list_due_notices(books, LATER_S, 0.0, {notice.key})] == ["hosts 300"]


def test_hosts_that_are_lost_together_share_one_notice_that_waits_for_all():
    names = [f"pc-{number:02d}" for number in range(1, 26)]
    fleet = make_fleet(names)
    events = [
        make_loss(fleet, host, 100.0 + index * OUTAGE_WINDOW_S / 25) for index, host in enumerate(names)
    ]
    books, _ = apply_events(make_fleet_books(fleet), *events)
    assert list_due_notices(books, 100.0 + OUTAGE_WINDOW_S / 2, 0.0, ()) == []
    (notice,) = list_due_notices(books, 100.0 + OUTAGE_WINDOW_S, 0.0, ())
    assert notice.text.startswith("25 hosts with 50 printers do not answer (pc-01 pc-02")
    assert "and 17 more): prints continue there without the farm; check their power" in notice.text
    (task,) = list_host_tasks(fleet, books)
    assert len(task.printers) == 50


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=12))
def test_no_loss_joins_a_notice_that_was_sent(loss_times_s):
    names, sent_keys = [f"pc-{number}" for number in range(len(loss_times_s))], set()
    fleet = make_fleet(names, printers_per_host=1)
    books = make_fleet_books(fleet)
    for host, lost_at_s in zip(names, sorted(loss_times_s), strict=True):
        books, _ = apply_events(books, make_loss(fleet, host, lost_at_s))
        loss = books.get_printer(f"{host}-1").host_loss
        assert f"hosts {loss.at_s:.0f}" in {
            due.key for due in list_due_notices(books, LATER_S, 0.0, sent_keys)
        }
        sent_keys |= {notice.key for notice in list_due_notices(books, lost_at_s, 0.0, sent_keys)}


def test_loss_just_after_a_notice_has_its_own_notice():
    fleet = make_fleet(["pc-a", "pc-b"])
    books, _ = apply_events(make_fleet_books(fleet), make_loss(fleet, "pc-a", 100.0))
    now_s = 100.0 + OUTAGE_WINDOW_S
    (notice,) = list_due_notices(books, now_s, 0.0, ())
    books, _ = apply_events(books, make_loss(fleet, "pc-b", now_s))
    assert [due.text[:4] for due in list_due_notices(books, LATER_S, 0.0, {notice.key})] == ["pc-b"]


def test_printer_that_was_moved_to_another_host_is_not_reported_as_lost():
    fleet = make_fleet(["pc-a"])
    books, _ = apply_events(make_fleet_books(fleet), make_loss(fleet, "pc-a", 100.0))
    sections = [section.model_copy(update={"host": "pc-c"}) for section in fleet.printers]
    assert list_host_tasks(fleet.model_copy(update={"printers": sections}), books) == []


def test_loss_is_stored_with_the_books(tmp_path):
    fleet = make_fleet(["pc-a", "pc-b"])
    event = make_loss(fleet, "pc-a", 100.0)
    books, _ = apply_events(make_fleet_books(fleet), event)
    store = Store(tmp_path / "farm.db")
    store.commit(event, Books(), books)
    store.close()
    store = Store(tmp_path / "farm.db")
    assert store.load().lost_hosts == {"pc-a"}
    store.close()


def test_few_hosts_are_all_named():
    losses = [HostLoss(host=host, at_s=1.0, reason="r") for host in ("pc-b", "pc-a", "pc-a")]
    assert describe_lost_hosts(losses).startswith("2 hosts with 3 printers do not answer (pc-a pc-b): ")
