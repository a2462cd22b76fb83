"""A whole job in a browser, from the dropped model to the cleared bed, on a simulated printer."""

import json
import re

import pytest
import trimesh
from playwright.sync_api import expect, sync_playwright

from browser.chromium import CHROMIUM, OPTIONS, TIME_LIMIT_S
from farms.real_farm import RealFarm, find_free_port, wait_for

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is missing: apt-get install chromium"),
]


@pytest.fixture
def farm(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    farm.fleet.write_text(farm.fleet.read_text() + f"web: {{listen: '127.0.0.1:{find_free_port()}'}}\n")
    farm.up()
    yield farm
    farm.end()


@pytest.fixture
def browser():
    expect.set_options(timeout=1000 * TIME_LIMIT_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield browser
        browser.close()


def open_context(browser, base):
    """Open a window with its own session and the time limit of the tests."""
    context = browser.new_context(base_url=base)
    context.set_default_timeout(1000 * TIME_LIMIT_S)
    return context


def drop_file(page, selector, path):
    """Drag a file onto an element, and drop it."""
    box = page.locator(selector).bounding_box()
    position = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    session = page.context.new_cdp_session(page)
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "data": data, **position})


def test_job_is_submitted_planned_printed_and_cleared_and_shown_in_two_tabs(farm, browser, tmp_path):
    model = tmp_path / "box.stl"
    # The print takes seven seconds here, because a busy daemon renders the pages only every few seconds.
    trimesh.creation.box((20.0, 20.0, 30.0)).export(model)
    link = json.loads(farm.run_checked("web", "--json"))["url"]
    base = link.partition("/login/")[0]
    context, messages, hosts = open_context(browser, base), [], set()
    context.on("console", lambda message: messages.append(message.text))
    context.on("request", lambda request: hosts.add(request.url.partition("/static/")[0][: len(base)]))
    desk_page = context.new_page()
    desk_page.goto(link)
    desk_page.locator("main button").click()
    expect(desk_page).to_have_url(f"{base}/")
    corridor_page = context.new_page()
    corridor_page.goto("/")

    submit_and_plan(desk_page, model)
    desk_page.get_by_role("button", name="Print it").click()
    expect(desk_page.locator("#part-rows")).to_contain_text("printing")
    expect(corridor_page.locator("#printer-um2-01")).to_contain_text("box")
    context.set_offline(True)
    for page in (desk_page, corridor_page):
        expect(page.locator(".stale")).to_contain_text("No updates from the farm since")
    wait_for("the end of the print", lambda: farm.read_job()["state"] == "printed")
    context.set_offline(False)
    expect(desk_page.locator("#part-rows")).to_contain_text("printed")
    expect(corridor_page.locator(".stale")).to_be_hidden()
    clear_bed(corridor_page)
    expect(desk_page.locator("#state")).to_contain_text("Every part is printed and good")
    farm.run_checked("down")
    expect(desk_page.locator(".stale")).to_be_visible()
    assert not [message for message in messages if "Content Security Policy" in message]
    assert hosts == {base}


def submit_and_plan(page, model):
    """Drop a model on the form, submit it, and wait for its plan."""
    page.goto("/submit")
    drop_file(page, "[name=file]", model)
    assert page.locator("[name=file]").evaluate("field => field.files[0].name") == "box.stl"
    page.get_by_role("button", name="Show the plan").click()
    expect(page).to_have_url(re.compile("/jobs/1$"))
    expect(page.locator("#state")).to_contain_text("Planned: 1 part on 1 printer")
    expect(page.locator("#state")).to_contain_text("Nothing prints before it is approved")


def clear_bed(page):
    """Confirm that the part was taken off the bed, as the first task requests."""
    task = page.locator("#todo")
    expect(task).to_contain_text("Clear 1 bed")
    task.get_by_role("button", name="Taken off, part is good").click()
    expect(task).to_contain_text("Nothing to do.")
