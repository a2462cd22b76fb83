"""Streams that keep pages up to date: messages to viewers, and ends of streams."""

import asyncio
import html
import json
import time
from contextlib import ExitStack
from urllib.parse import urlencode

import pytest

from books.planned_job import plan_job
from farm.control import PAGE_DRY_RUN_TIMEOUT_S
from farm.errors import NotFoundError
from farm.http import StreamLimit
from farm.model import Role
from farm.web.live import LivePages
from farms.network_farm import HOST, NetworkFarm

HEARTBEAT = b"event: beat\ndata:\n\n"


class Page:
    """Page that shows one number and counts its renderings."""

    def __init__(self):
        self.number, self.render_count, self.error, self.pauses = 0, 0, None, 0

    async def render(self, user, variable, query):
        self.render_count += 1
        for _ in range(self.pauses):  # other work meanwhile
            await asyncio.sleep(0)
        if self.error is not None:
            raise self.error
        element = f'<p id="n">{self.number} {user.role} {variable}{query}</p>'
        return f'<body><main id="main"><!--live:n-->{element}<!--/live--></main></body>'


@pytest.fixture
def page():
    return Page()


class QuickStreams(StreamLimit):
    """Streams whose waits take no time; each round of renderings begins with a wait."""

    rounds = 0

    async def wait(self, seconds):
        self.rounds += 1
        await asyncio.sleep(0.0)


def parse_message(message):
    """Return the version and the changes of a message."""
    fields = dict(line.split(": ", 1) for line in message.decode().strip().split("\n"))
    return fields["id"], json.loads(fields["data"])


async def read_changes(stream):
    """Return the version and the changes of the next message that is not a heartbeat."""
    while (message := await anext(stream)) == HEARTBEAT:
        pass
    return parse_message(message)


def open_stream(pages, role=Role.LOOK, version="", path="/x/7", is_allowed=lambda: True):
    return pages.follow(path, role, version, is_allowed)


def run_with_pages(page, check_streams):
    async def main():
        streams = QuickStreams()
        pages = LivePages(streams)
        pages.add("/x/{number}", page.render)
        pages.add("/slow", page.render, rounds_per_rendering=10)
        async with asyncio.timeout(20):
            await check_streams(pages, streams)
            streams.close()
            if pages._refresh_task is not None:
                await pages._refresh_task

    asyncio.run(main())


def test_viewer_gets_the_page_and_then_its_changes(page):
    async def check_streams(pages, _):
        stream = open_stream(pages)
        assert await anext(stream) == b"retry: 3000\n\n"
        version, changes = parse_message(await anext(stream))
        assert changes == {"main": '<main id="main"><p id="n">0 look 7</p></main>'}
        page.number = 1
        next_version, changes = await read_changes(stream)
        assert changes == {"n": '<p id="n">1 look 7</p>'}
        assert next_version != version
        known_stream = open_stream(pages, version=next_version)
        await anext(known_stream)
        assert await anext(known_stream) == HEARTBEAT
        late_stream = open_stream(pages, version="another")
        await anext(late_stream)
        assert list(parse_message(await anext(late_stream))[1]) == ["main"]
        for client in (stream, known_stream, late_stream):
            await client.aclose()

    run_with_pages(page, check_streams)


def test_page_is_rendered_once_for_all_viewers_of_a_role_and_not_without_viewers(page):
    async def check_streams(pages, limit):
        streams = [open_stream(pages, role) for role in (Role.LOOK, Role.OPERATE) for _ in range(10)]
        for stream in streams:
            await anext(stream)
            await anext(stream)
        page.number = 1
        changes_seen = [await read_changes(stream) for stream in streams]
        assert {text for _, changes in changes_seen for text in changes.values()} == {
            '<p id="n">1 look 7</p>',
            '<p id="n">1 operate 7</p>',
        }
        assert page.render_count <= 2 * (limit.rounds + 1)  # two renderings in a round, not twenty
        for stream in streams:
            await stream.aclose()
        await pages._refresh_task
        render_count = page.render_count
        await asyncio.sleep(0.0)
        assert page.render_count == render_count

    run_with_pages(page, check_streams)


def test_streams_end_with_the_daemon_and_when_the_viewer_loses_access(page):
    async def check_streams(pages, streams):
        permissions = [True]
        stream, other_stream = open_stream(pages), open_stream(pages, is_allowed=lambda: permissions[0])
        for client in (stream, other_stream):
            await anext(client)
            await anext(client)
        permissions[0] = False
        page.number = 1
        with pytest.raises(StopAsyncIteration):
            await anext(other_stream)
        streams.close()
        with pytest.raises(StopAsyncIteration):
            await read_changes(stream)
            await read_changes(stream)

    run_with_pages(page, check_streams)


@pytest.mark.parametrize("error", [NotFoundError("it was pruned"), ValueError("a fault")])
def test_page_that_cannot_be_rendered_ends_its_streams_and_can_be_opened_again(page, error):
    async def check_streams(pages, _):
        stream = open_stream(pages)
        await anext(stream)
        await anext(stream)
        page.error = error
        with pytest.raises(StopAsyncIteration):
            await read_changes(stream)
        page.error = None
        second_stream = open_stream(pages)
        await anext(second_stream)
        assert "main" in parse_message(await anext(second_stream))[1]
        await second_stream.aclose()

    run_with_pages(page, check_streams)


def test_stream_of_an_unknown_page_or_beyond_the_limit_is_refused(tmp_path):
    farm = NetworkFarm(tmp_path)
    session = farm.open_session()
    home = farm.browse("GET", "/", session).text
    version = home.partition('data-version="')[2].partition('"')[0]
    assert len(version) == 18
    assert farm.browse("GET", "/live?page=/nothing", session).status_code == 404
    with ExitStack() as open_streams:
        for _ in range(20):
            open_streams.enter_context(farm.services.page_streams.count_stream("ann"))
        response = farm.browse("GET", "/live?page=/", session)
    assert (response.status_code, "too many streams" in response.text) == (409, True)
    farm.services.page_streams.close()
    response = farm.browse("GET", "/live?page=/", session)
    assert (response.status_code, "shutting down" in response.text) == (409, True)
    farm.store.close()


def test_page_of_several_rounds_is_rendered_in_the_last_round_or_for_a_newer_version(page):
    async def check_streams(pages, limit):
        stream = open_stream(pages, path="/slow")
        await anext(stream)
        await anext(stream)
        render_count, rounds, page.number = page.render_count, limit.rounds, 1
        next_version, changes = await read_changes(stream)
        assert (page.render_count, limit.rounds - rounds) == (render_count + 1, 10)
        assert changes == {"n": '<p id="n">1 look </p>'}
        page.number = 2
        known_stream = open_stream(pages, path="/slow", version=next_version)
        await anext(known_stream)
        assert await anext(known_stream) == HEARTBEAT
        later_stream = open_stream(pages, path="/slow", version="of a page that was loaded just now")
        await anext(later_stream)
        assert "2 look" in parse_message(await anext(later_stream))[1]["main"]
        for client in (stream, known_stream, later_stream):
            await client.aclose()

    run_with_pages(page, check_streams)


def test_page_does_not_end_while_it_is_rendered_for_its_only_viewer(page):
    async def check_streams(pages, limit):
        first_stream = open_stream(pages, path="/slow")
        await anext(first_stream)
        await first_stream.aclose()
        page.pauses = 10
        late_stream = open_stream(pages, path="/slow", version="later")
        assert [await anext(late_stream), parse_message(await anext(late_stream))[1].keys()] == [
            b"retry: 3000\n\n",
            {"main"},
        ]
        await late_stream.aclose()

    run_with_pages(page, check_streams)


def test_query_of_an_address_is_passed_to_the_page(page):
    async def check_streams(pages, _):
        stream = open_stream(pages, path="/x/7?days=3")
        await anext(stream)
        assert "0 look 7days=3" in parse_message(await anext(stream))[1]["main"]
        await stream.aclose()

    run_with_pages(page, check_streams)


def test_stream_continues_its_page_and_other_addresses_are_errors(tmp_path):
    farm = NetworkFarm(tmp_path)
    plan_job(farm, hold=True)
    session = farm.open_session()
    for address in (
        "/", "/jobs/1", "/jobs/1?curve=2", "/printers/a", "/timeline?hours=24&job=1&to=last",
        "/history?days=7",
    ):  # fmt: skip
        response = farm.browse("GET", address, session).text
        assert html.unescape(response.partition('data-live="')[2].partition('"')[0]) == address
        version, changes = parse_message(asyncio.run(read_first_event(farm, session, address)))
        assert (f'data-version="{version}"' in response, list(changes)) == (True, ["main"])
        farm.services.page_streams._close_event.clear()
    for address, status in {
        "/history?days=x": 400, "/timeline?hours=1": 400, "/jobs/x": 404, "/jobs/9": 404, "/printers/x": 404,
    }.items():  # fmt: skip
        response = farm.browse("GET", f"/live?{urlencode({'page': address})}", session)
        assert response.status_code == status
    farm.store.close()


async def read_first_event(farm, session, address):
    """Return the first event with data of the stream of a page, and end the stream."""
    events, requests = [], [{"type": "http.request", "body": b""}]

    async def receive():
        return requests.pop() if requests else await asyncio.Future()

    async def send(message):
        if b"data: {" in message.get("body", b""):
            events.append(message["body"])
            farm.services.page_streams.close()

    headers = {"host": HOST, **farm.make_cookie_header(session)}
    scope = {
        "type": "http",
        "method": "GET",
        "path": "/live",
        "query_string": urlencode({"page": address}).encode(),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    async with asyncio.timeout(20):
        await farm.web(scope, receive, send)
    return events[0]


def test_dry_run_is_kept_while_its_page_is_open(tmp_path):
    farm = NetworkFarm(tmp_path)
    plan_job(farm, hold=True, dry_run=True)
    session = farm.open_session()
    opened_s = time.monotonic()
    asyncio.run(read_first_event(farm, session, "/jobs/1"))
    farm.dry_runs.cancel_abandoned_runs(opened_s + PAGE_DRY_RUN_TIMEOUT_S - 1.0)
    assert not farm.controller.books.get_job(1).state.ended
    farm.dry_runs.cancel_abandoned_runs(time.monotonic() + PAGE_DRY_RUN_TIMEOUT_S + 1.0)
    assert farm.controller.books.get_job(1).state.ended
    farm.store.close()
