"""A whole job in the browser, from the dropped model to the cleared bed, on a simulated printer."""

import asyncio
import json

import pytest
import trimesh

from chromium import CHROMIUM, Chromium
from real_farm import RealFarm, free_port, wait_for

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="apt-get install chromium"),
]
STALE = "document.querySelector('.stale:not([hidden])')"


def has(text, root):
    """Return an expression that is true once an element has these words."""
    return f"document.querySelector({root!r})?.innerText.includes({text!r})"


@pytest.fixture
def farm(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    farm.fleet.write_text(farm.fleet.read_text() + f"web: {{listen: '127.0.0.1:{free_port()}'}}\n")
    yield farm
    farm.end()


def test_job_is_dropped_planned_printed_taken_off_and_seen_in_two_tabs(farm, tmp_path):
    model = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 20.0, 3.0)).export(model)
    farm.up()
    link = json.loads(farm.ok("web", "--json"))["url"]

    async def use():
        async with Chromium(tmp_path / "profile", "MAP * 127.0.0.1") as desk:
            await desk.open(link)
            await desk.press("main button")
            home = await desk.evaluate("location.origin")
            corridor = await desk.open_tab()
            await corridor.open(home)
            await submit(desk, home)
            await print_job(desk, corridor)
            await clear(desk, corridor)
            await asyncio.to_thread(farm.ok, "down")
            await desk.wait_for(STALE)
            assert not [message for message in desk.messages if "Content Security Policy" in message]

    async def submit(desk, home):
        await desk.open(f"{home}/submit")
        await desk.drop_file("[name=file]", model)
        assert await desk.evaluate("document.querySelector('[name=file]').files[0].name") == "box.stl"
        await desk.press("button[value=plan]")
        assert await desk.evaluate("location.pathname") == "/jobs/1"
        await desk.wait_for(has("Planned: 1 part on 1 printer", "#state"))
        await desk.open(f"{home}/jobs/1")  # a page with other sections loads itself anew
        await desk.wait_for(has("Nothing prints before it is approved", "#state"))

    async def print_job(desk, corridor):
        await desk.press("form[action='/jobs/1/release'] button")
        await desk.wait_for(has("printing", "#part-rows"))
        await corridor.wait_for(has("box", "#printer-um2-01"))
        await corridor.cut_network()
        await corridor.wait_for(STALE)
        assert "No news from the farm since" in await corridor.evaluate(f"{STALE}.innerText")
        desk.sleep()  # the computer of both windows
        await asyncio.to_thread(wait_for, "the end", lambda: farm.job()["state"] == "printed")
        desk.sleep(False)
        await desk.wait_for(has("printed", "#part-rows"))

    async def clear(desk, corridor):
        await corridor.cut_network(False)
        await corridor.wait_for(f"{STALE} === null && {has('Clear 1 bed', '#todo')}")
        await corridor.press("#todo .beds button")
        await corridor.wait_for(has("Nothing.", "#todo"))
        await desk.wait_for(has("Every part is printed and good", "#state"))

    asyncio.run(use())
