"""Log-in, pages and log-out in Chromium; skipped if Chromium is missing."""

import asyncio
import os
from pathlib import Path

import pytest

from browser.chromium import CHROMIUM, Chromium
from farm.model import Role
from farms.network_farm import HOST, NetworkFarm
from farms.served_farm import serve

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is missing: apt-get install chromium"),
]
PICTURE_FOLDER = os.environ.get("FARM_PICTURES")
"""Folder for pictures of the pages; None if no pictures are wanted."""


async def take_picture(browser, name):
    if PICTURE_FOLDER:
        await browser.take_picture(Path(PICTURE_FOLDER) / f"{name}.png")


@pytest.mark.parametrize("host", ["127.0.0.1", HOST])
def test_user_logs_in_by_a_button_sees_the_farm_and_logs_out(tmp_path, host):
    """Also use a host name over plain HTTP: to this untrusted origin, the browser sends only `Origin`."""

    async def browse():
        farm = NetworkFarm(tmp_path)
        async with (
            serve(farm) as (port, _),
            Chromium(tmp_path / "profile", f"MAP {HOST} 127.0.0.1") as browser,
        ):
            base = f"http://{host}:{port}"
            await browser.open(base)
            assert "farm web" in await browser.read_text()
            await browser.open(f"{base}/login/{farm.sessions.make_link('ann', Role.OPERATE)}")
            assert "logs you in as ann (operate)" in await browser.read_text()
            await take_picture(browser, "login")
            await browser.press("button")
            text = await browser.read_text()
            assert await browser.evaluate("location.pathname") == "/"
            assert "ann (operate)" in text
            assert "idle" in text
            assert await browser.evaluate("document.cookie") == ""  # no script can read it
            font = "getComputedStyle(document.body).fontFamily"
            assert "system-ui" in await browser.evaluate(font)  # the style sheet is applied
            await take_picture(browser, "status")
            await browser.press("button")
            assert "You have logged out" in await browser.read_text()
            await browser.open(base)
            assert "You are not logged in" in await browser.read_text()
            assert not [message for message in browser.messages if "Content Security Policy" in message]
        farm.store.close()

    asyncio.run(browse())


def test_form_of_another_site_changes_nothing(tmp_path):
    async def browse():
        farm = NetworkFarm(tmp_path)
        async with (
            serve(farm) as (port, _),
            Chromium(tmp_path / "profile", "MAP *.example 127.0.0.1") as browser,
        ):
            base = f"http://{HOST}:{port}"
            await browser.open(f"{base}/login/{farm.sessions.make_link('ann', Role.OPERATE)}")
            await browser.press("button")
            event_count = len(farm.store.read_all_events())
            form = f"<form method=post action='{base}/logout'><button>x</button></form>"
            await browser.open(f"data:text/html,{form}")
            await browser.press("button")
            assert "page of another site" in await browser.read_text()
            assert len(farm.store.read_all_events()) == event_count
        farm.store.close()

    asyncio.run(browse())
