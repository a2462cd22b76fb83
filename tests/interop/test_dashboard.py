"""The dashboard in Chromium: accessibility, policy, live changes, lost connections, use without scripts."""

import asyncio
import base64
import re

import pytest

from books.make_books import make_end_event
from books.planned_job import plan_job, submit_model
from browser.accessibility import AXE_SCRIPT, await_value, find_faults
from browser.chromium import CHROMIUM, Chromium
from farm.model import (
    AgentSnapshot,
    FilamentState,
    Hold,
    HoldCode,
    Link,
    PrintState,
    Role,
    TextTime,
    Verdict,
)
from farm.state import events as ev
from farms.network_farm import HOST, NetworkFarm
from farms.served_farm import serve

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is missing: apt-get install chromium"),
]
PAGES = (
    *("/", "/submit", "/jobs/1", "/timeline", "/timeline?job=1&at=2030-01-01T00:00", "/printers/a"),
    *("/printers/a/wire", "/history", "/login", "/api/v1/docs", "/nothing"),
)
TASK_ELEMENT = "document.querySelector('.task')"
STALE_ELEMENT = "document.querySelector('.stale')"
RESOURCE_HOSTS_SCRIPT = "performance.getEntriesByType('resource').map((entry) => new URL(entry.name).host)"


def make_bed_unknown(farm, reason="the lid was open"):
    farm.controller.handle(ev.BedBecameUnknown(at_s=farm.clock.now(), printer="a", reason=reason))


def run_in_browser(tmp_path, scenario):
    """Run a scenario in a browser in which ann has logged in, at a farm with a task and a planned job."""

    async def run():
        farm = NetworkFarm(tmp_path)
        plan_job(farm, hold=True)
        make_bed_unknown(farm)
        browser = Chromium(tmp_path / "profile", f"MAP {HOST} 127.0.0.1")
        async with serve(farm) as (port, _), browser:
            base = f"http://127.0.0.1:{port}"
            await browser.open(f"{base}/login/{farm.sessions.make_link('ann', Role.OPERATE)}")
            await browser.press("button")
            await scenario(farm, browser, base)
            farm.services.page_streams.close()
        assert not [message for message in browser.messages if "Content Security Policy" in message]
        farm.store.close()

    asyncio.run(run())


@pytest.mark.skipif(not AXE_SCRIPT.exists(), reason="axe is missing: make pages")
def test_pages_are_accessible_load_nothing_from_other_hosts_and_fit_a_narrow_phone(tmp_path):
    async def scenario(farm, browser, base):
        results = {}
        link = f"/login/{farm.sessions.make_link('ann', Role.LOOK)}"
        for path in (*PAGES, link):
            await browser.open(base + path)
            assert set(await await_value(browser, RESOURCE_HOSTS_SCRIPT)) <= {base.removeprefix("http://")}, (
                path
            )
            if faults := await find_faults(browser):
                results[path] = faults
        assert results == {}

    run_in_browser(tmp_path, scenario)


OUTCOMES = (
    (PrintState.FAILED, None),
    (PrintState.DONE, Verdict.GOOD),
    (PrintState.DONE, Verdict.BAD),
    (PrintState.DONE, None),
)


def print_outcomes(farm):
    """Print a part with each outcome, then raise an alarm on the printer and pause a job."""
    controller, now_s = farm.controller, farm.clock.now_s
    cleared = ev.BedCleared(at_s=now_s, printer="a", by="ann", filament=FilamentState.PARKED)
    controller.handle(cleared, ev.JobApproved(at_s=now_s, job=1, by="ann"))
    for state, verdict in OUTCOMES:
        attempt = controller.books.find_open_print("a")
        reason = "the nozzle got cold" if state is PrintState.FAILED else None
        end_event = make_end_event(attempt.id, state, at_s=now_s, started_s=now_s - 60.0, reason=reason)
        controller.handle(end_event)
        if state is PrintState.FAILED or verdict is not None:
            controller.handle(cleared.model_copy(update={"verdict": verdict or Verdict.GOOD}))
    alarm = {"alarm": "the nozzle cannot be switched off", "nozzle_c": 231.0, "bed_c": 60.0}
    controller.on_snapshot(AgentSnapshot(printer="a", link=Link.FAULT, reason="inspect it", **alarm))
    number = submit_model(farm, user="bob")
    controller.handle(ev.JobPaused(at_s=now_s, job=number, wanted=True, by="bob"))


@pytest.mark.skipif(not AXE_SCRIPT.exists(), reason="axe is missing: make pages")
def test_pages_with_every_outcome_and_an_alarm_are_accessible(tmp_path):
    async def scenario(farm, browser, base):
        print_outcomes(farm)
        faults_by_page = {}
        for path in ("/", "/jobs/1", "/jobs/2", "/timeline", "/printers/a", "/history"):
            await browser.open(base + path)
            if faults := await find_faults(browser):
                faults_by_page[path] = faults
        assert faults_by_page == {}

    run_in_browser(tmp_path, scenario)


def test_home_page_is_updated_and_keeps_the_focus(tmp_path):
    async def scenario(farm, browser, _):
        await browser.evaluate("window.sameDocument = true; document.querySelector('nav a').focus()")
        assert "the lid was open" in await browser.evaluate(f"{TASK_ELEMENT}.innerText")
        make_bed_unknown(farm, "its board was reset")
        await browser.wait_for(f"{TASK_ELEMENT}.innerText.includes('its board was reset')")
        assert await browser.evaluate("document.activeElement.textContent") == "Home"
        assert await browser.evaluate("window.sameDocument") is True

    run_in_browser(tmp_path, scenario)


MARKED_TEXTS = (
    "[...document.querySelectorAll('time, [data-time]')].map((element) => element.textContent).join('; ')"
)


def read_times(text):
    """Return the minutes of the day of all times in a text."""
    return [60 * int(hours) + int(minutes) for hours, minutes in re.findall(r"(\d\d):(\d\d)", text)]


def test_times_in_sentences_and_charts_are_in_the_reader_s_time_zone(tmp_path):
    async def scenario(farm, browser, base):
        start = TextTime(text="Tue 22:15", at="2023-11-14T22:15:00+00:00")
        hold = Hold(code=HoldCode.START_TIME, text="its job starts Tue 22:15", times=(start,))
        farm.controller.scheduler.find_plate_holds = lambda: {"1/01": hold}
        pages = {}
        for zone in ("UTC", "Asia/Tokyo"):
            await browser.call("Emulation.setTimezoneOverride", timezoneId=zone)
            await browser.open(f"{base}/jobs/1")
            pages[zone] = await browser.read_text()
            pages[f"times {zone}"] = read_times(await browser.evaluate(MARKED_TEXTS))
        assert "Times are in UTC, the farm's time zone." in pages["UTC"]
        assert "Times are in your time zone, Asia/Tokyo. The farm is in UTC." in pages["Asia/Tokyo"]
        assert "its job starts Tue 22:15" in pages["UTC"]
        assert re.search(r"its job starts .*07:15", pages["Asia/Tokyo"])
        local_minutes = [(time + 9 * 60) % (24 * 60) for time in pages["times UTC"]]
        assert len(local_minutes) > 5
        assert pages["times Asia/Tokyo"] == local_minutes
        await browser.open(f"{base}/timeline")
        assert "All times on this page are in UTC" in await browser.read_text()
        assert "your time zone" not in await browser.read_text()

    run_in_browser(tmp_path, scenario)


def test_page_without_updates_states_so_and_recovers(tmp_path):
    async def scenario(farm, browser, _):
        await browser.wait_for(f"{STALE_ELEMENT} !== null && {STALE_ELEMENT}.hidden")
        streams = farm.services.page_streams
        streams.close()
        await browser.wait_for(f"!{STALE_ELEMENT}.hidden")
        assert "No updates from the farm since" in await browser.evaluate(f"{STALE_ELEMENT}.innerText")
        make_bed_unknown(farm, "its board was reset")
        streams._close_event.clear()
        await browser.wait_for(
            f"{STALE_ELEMENT}.hidden && {TASK_ELEMENT}.innerText.includes('its board was reset')"
        )

    run_in_browser(tmp_path, scenario)


def test_page_catches_up_after_the_computer_has_slept(tmp_path):
    async def scenario(farm, browser, _):
        await browser.wait_for(f"{STALE_ELEMENT} !== null && {STALE_ELEMENT}.hidden")
        browser.suspend()
        make_bed_unknown(farm, "its board was reset")
        browser.suspend(False)
        await browser.wait_for(
            f"{STALE_ELEMENT}.hidden && {TASK_ELEMENT}.innerText.includes('its board was reset')"
        )

    run_in_browser(tmp_path, scenario)


CHART_ELEMENT = "document.querySelector('[data-now]')"
DEGREE_BOXES = (
    "[...document.querySelectorAll('.degrees text')].map((element) => element.getBoundingClientRect())"
)


@pytest.mark.parametrize("width_px", [390, 320])
def test_degrees_stay_in_view_beside_a_chart_that_scrolls(tmp_path, width_px):
    async def scenario(farm, browser, base):
        for nozzle_c in (21.0, 180.0):
            farm.controller.on_snapshot(
                AgentSnapshot(printer="a", link=Link.READY, nozzle_c=nozzle_c, bed_c=20.0)
            )
        size = {"width": width_px, "height": 800, "deviceScaleFactor": 1, "mobile": True}
        await browser.call("Emulation.setDeviceMetricsOverride", **size)
        await browser.open(f"{base}/printers/a")
        for scroll_px in (0, 2000):
            await browser.evaluate(f"{CHART_ELEMENT}.scrollLeft = {scroll_px}")
            positions = await await_value(browser, f"{DEGREE_BOXES}.map((box) => [box.left, box.right])")
            assert len(positions) == 5  # 0 to 200
            assert all(0 <= left < right <= width_px for left, right in positions)
        assert (
            await browser.evaluate(f"{CHART_ELEMENT}.scrollLeft") > width_px
        )  # as the chart is scrolled to the present

    run_in_browser(tmp_path, scenario)


PAPER_WIDTH_PX = 718  # A4 between margins of 10 mm, at 96 px an inch
IS_LIGHT_SCRIPT = "getComputedStyle(document.body).backgroundColor === 'rgb(255, 255, 255)'"
VISIBLE_FIELD_COUNT = (
    "[...document.querySelectorAll('nav, form, input')].filter((element) => element.checkVisibility()).length"
)


@pytest.mark.parametrize("path", ["/", "/jobs/1", "/timeline", "/printers/a", "/history"])
def test_printed_pages_fit_the_paper_without_forms_on_a_white_background(tmp_path, path):
    async def scenario(farm, browser, base):
        await browser.open(base + path)
        dark_scheme = [{"name": "prefers-color-scheme", "value": "dark"}]
        await browser.call("Emulation.setEmulatedMedia", media="print", features=dark_scheme)
        size = {"width": PAPER_WIDTH_PX, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
        await browser.call("Emulation.setDeviceMetricsOverride", **size)
        assert await browser.evaluate(VISIBLE_FIELD_COUNT) == 0
        assert await browser.evaluate(IS_LIGHT_SCRIPT) is True
        assert await browser.evaluate("document.documentElement.scrollWidth") <= PAPER_WIDTH_PX
        pdf = base64.b64decode((await browser.call("Page.printToPDF"))["data"])
        assert pdf.startswith(b"%PDF-")

    run_in_browser(tmp_path, scenario)


def test_forms_work_without_scripts_and_by_keyboard(tmp_path):
    async def scenario(farm, browser, base):
        await browser.call("Emulation.setScriptExecutionDisabled", value=True)
        await browser.open(base)
        focus_path = []
        for _ in range(3):
            await press_key(browser, "Tab", 9)
            focus_path.append(await browser.evaluate("document.activeElement.textContent"))
        assert focus_path == ["Skip to the content", "Home", "Submit"]
        await browser.press(".task form[action='/printers/a/cleared'] button")
        assert "a is clear." in await browser.read_text()
        assert "Inspect a" not in await browser.read_text()

    run_in_browser(tmp_path, scenario)


async def press_key(browser, key, code):
    """Press and release a key."""
    key_fields = {"key": key, "windowsVirtualKeyCode": code}
    await browser.call("Input.dispatchKeyEvent", type="keyDown", **key_fields)
    await browser.call("Input.dispatchKeyEvent", type="keyUp", **key_fields)
