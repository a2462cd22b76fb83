"""Take screenshots of the dashboard, with a real daemon, simulated printers and headless Chromium.

If a run is interrupted, its farm keeps running; the next run takes only the pictures that are missing.

Usage: PYTHONPATH=tests/support python docs/screenshots.py [--only PAGE ...] [--folder FOLDER] [--keep]
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import io
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from PIL import Image

from browser.chromium import CHROMIUM, Chromium  # type: ignore[import-not-found]  # in tests/support

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures" / "dashboard"
FARM = Path(sys.executable).with_name("farm")
FOLDER = ROOT / "build" / "screenshots"
PORT = 8479
TIME_SCALE = 120
TIMEOUT_S = 900.0
WIDTHS_PX = (390, 1280, 1920)
THEMES = ("light", "dark")
MAX_HEIGHTS_PX = {"api": 1200}  # the beginning of this long page is enough
DEFAULT_MAX_HEIGHT_PX = 4000
COLOURS = 256
LOGIN = "login"
PAGES = {
    LOGIN: "/login/",  # followed by the secret of a link
    "home": "/",
    "submit": "/submit",
    "job": "/jobs/1",
    "report": "/jobs/1/report",
    "timeline": "/timeline",
    "what-if": "/timeline?job=3&at=22:00",
    "printer": "/printers/um2-04",
    "wire": "/printers/um2-04/wire",
    "history": "/history",
    "api": "/api/v1/docs",
}
ZONES = (
    "Pacific/Auckland",
    "Asia/Tokyo",
    "Asia/Dubai",
    "Europe/Berlin",
    "America/New_York",
    "America/Vancouver",
)
FLEET = """
fleet:
  name: lab
  timezone: {zone}
  time_scale: {scale}
  currency: EUR
  attended: ["mon-sun 07:00-20:00"]
  quiet: ["23:00-06:00"]
  compute: {{budget_s: 3}}
web: {{listen: "127.0.0.1:{port}"}}
defaults: {{material: generic_pla, colour: white, price_per_kg: 28.50}}
printers:
"""


class DemoFarm:
    """Farm with simulated printers, in a separate folder.

    Parameters
    ----------
    folder
        Folder for the farm's state, its fleet file, and the list of the pictures that were taken.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._picture_list = folder, folder / "taken"
        self.has_jobs = self._picture_list.exists() and self._is_up()

    def _is_up(self) -> bool:
        """Return whether a daemon answers."""
        return subprocess.run(self._build_command("status"), capture_output=True).returncode == 0

    def _build_command(self, *arguments: str) -> list[str]:
        return [str(FARM), *arguments, "--state", str(self._folder / "state")]

    def prepare(self) -> None:
        """Empty the folder, which may contain files of an interrupted run, and write the fleet file."""
        self.clear()
        self._folder.mkdir(parents=True)
        models = ["ultimaker2_plus"] * 5 + ["ultimaker2_extended_plus"] * 2
        rows = [
            f'  - {{name: um2-{n:02d}, model: {model}, port: "sim://{model}?seed={n}"}}\n'
            for n, model in enumerate(models, 1)
        ]
        text = FLEET.format(zone=find_afternoon_zone(), scale=TIME_SCALE, port=PORT) + "".join(rows)
        (self._folder / "fleet.yaml").write_text(text)

    def clear(self) -> None:
        """Stop the farm, if it is up, and delete the folder."""
        if self._is_up():
            self.run_farm("down", "--now")
        shutil.rmtree(self._folder, ignore_errors=True)

    def list_pictures(self) -> list[str]:
        """Return the names of the pictures that were taken."""
        return self._picture_list.read_text().split() if self._picture_list.exists() else []

    def record_pictures(self, *names: str) -> None:
        """Record that pictures were taken; without names, record that the jobs are ready for pictures."""
        with self._picture_list.open("a") as file:
            file.writelines(f"{name}\n" for name in names)

    def run_farm(self, *arguments: str) -> str:
        """Run a farm command, and return what it prints."""
        command = self._build_command(*arguments)
        command += ["--fleet", str(self._folder / "fleet.yaml")] if arguments[0] == "up" else []
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

    def make_link(self) -> str:
        """Return the address of a new link that logs in."""
        return str(json.loads(self.run_farm("web", "--json"))["url"])

    def read_status(self) -> Any:
        """Return `farm status --json`."""
        return json.loads(self.run_farm("status", "--json"))

    def wait(self, subject: str, condition: Callable[[Any], object]) -> Any:
        """Wait until the status meets a condition, and return that status."""
        deadline_s = time.monotonic() + TIMEOUT_S
        print(f"waiting for {subject} ...", flush=True)
        while not condition(status := self.read_status()):
            if time.monotonic() > deadline_s:
                raise SystemExit(f"gave up waiting for {subject}")
            time.sleep(1.0)
        return status


def find_afternoon_zone() -> str:
    """Return the time zone in which the time is closest to 15:00, so that prints begin in attended hours."""
    now_s = time.time()
    return min(ZONES, key=lambda zone: abs(datetime.fromtimestamp(now_s, ZoneInfo(zone)).hour - 15))


def run_jobs(demo_farm: DemoFarm) -> None:
    """Print a model with one failed part; clear most beds, so that another job prints while others wait."""
    folder = Path(tempfile.mkdtemp())
    aqueduct = str(folder / "aqueduct.stl")
    subprocess.run([sys.executable, str(ROOT / "examples" / "make_aqueduct.py"), aqueduct], check=True)
    demo_farm.run_farm("up")
    demo_farm.wait("printers", lambda s: all(printer["state"] == "idle" for printer in s["printers"]))
    demo_farm.run_farm("submit", aqueduct, "--name", "Aqueduct", "--note", "for the exhibition")
    demo_farm.wait("the plan", lambda s: s["jobs"][0]["plates"])
    for name, options in (
        ("Model of a bridge", ["--longest-side", "200", "--copies", "4"]),
        ("Viaduct", ["--longest-side", "120", "--copies", "2", "--hold"]),
        ("Tomorrow's aqueduct", ["--longest-side", "140", "--copies", "2", "--overnight"]),
    ):
        demo_farm.run_farm("submit", aqueduct, "--name", name, *options)
    demo_farm.wait("plans", lambda s: all(job["plates"] for job in s["jobs"]))
    status = demo_farm.wait("a print", list_printing)
    demo_farm.run_farm("fail", list_printing(status)[0]["name"], "--why", "the first layer came off")
    status = demo_farm.wait("a part", lambda s: [p for p in s["printers"] if has_done_print(p)])
    demo_farm.run_farm("cleared", next(p["name"] for p in status["printers"] if has_done_print(p)))
    demo_farm.wait("the other parts", lambda s: s["jobs"][0]["state"] == "printed")
    for printer in [p for p in demo_farm.read_status()["printers"] if p["look"] is None][2:]:
        demo_farm.run_farm("cleared", printer["name"])
    demo_farm.wait("another print", list_printing)
    demo_farm.record_pictures()
    print("the farm is ready for pictures", flush=True)


def list_printing(status: Any) -> list[Any]:
    """Return the printers that are printing."""
    return [printer for printer in status["printers"] if printer["state"] == "printing"]


def has_done_print(printer: Any) -> bool:
    """Return whether the last print of a printer is done."""
    return bool(printer["last"]) and printer["last"]["state"] == "done"


async def take_pictures(demo_farm: DemoFarm, zone: str, profile: Path, names: list[str]) -> None:
    """Take a picture of each page in each width and theme, except those that were already taken.

    Parameters
    ----------
    demo_farm
        The farm, with the list of the pictures that were taken.
    zone
        Time zone of the browser.
    profile
        Folder for the browser's profile.
    names
        Pages, as in `PAGES`.
    """
    address, old_pictures = demo_farm.make_link(), set(demo_farm.list_pictures())
    base = address.partition(PAGES[LOGIN])[0]
    PICTURES.mkdir(parents=True, exist_ok=True)
    async with Chromium(profile, "") as browser:
        await browser.open(address)
        await browser.press("main button")
        for theme in THEMES:
            feature = {"name": "prefers-color-scheme", "value": theme}
            await browser.call("Emulation.setEmulatedMedia", features=[feature])
            await browser.call("Emulation.setTimezoneOverride", timezoneId=zone)
            for width_px in WIDTHS_PX:
                await resize_window(browser, width_px, 900)
                for name in names:
                    picture = f"{name}-{width_px}-{theme}.png"
                    if picture in old_pictures:
                        continue
                    await browser.open(demo_farm.make_link() if name == LOGIN else base + PAGES[name])
                    await asyncio.sleep(1.0 if name in ("job", "submit") else 0.3)  # for scripts that draw
                    max_height_px = MAX_HEIGHTS_PX.get(name, DEFAULT_MAX_HEIGHT_PX)
                    await save_picture(browser, width_px, PICTURES / picture, max_height_px)
                    demo_farm.record_pictures(picture)
        for message in browser.messages:
            print(f"the browser says: {message}")


async def resize_window(browser: Chromium, width_px: int, height_px: int) -> None:
    """Set the size of the browser's window."""
    await browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width_px,
        height=height_px,
        deviceScaleFactor=1,
        mobile=width_px < 600,
    )


async def save_picture(browser: Chromium, width_px: int, path: Path, max_height_px: int) -> None:
    """Save a picture of the page, cropped to a height, with few colours to keep the repository small."""
    height_px = await browser.evaluate("document.documentElement.scrollHeight")
    overflow_px = await browser.evaluate("document.documentElement.scrollWidth") - width_px
    if overflow_px > 0:
        print(f"{path.name}: {overflow_px} px wider than the window")
    clip = {"x": 0, "y": 0, "width": width_px, "height": min(max_height_px, height_px), "scale": 1}
    screenshot = await browser.call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
    picture = Image.open(io.BytesIO(base64.b64decode(screenshot["data"]))).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> int:
    """Take the pictures, and return an exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=PAGES, default=list(PAGES))
    parser.add_argument("--folder", type=Path, default=FOLDER, help="folder of the farm: build/screenshots")
    parser.add_argument(
        "--keep", action="store_true", help="keep the farm running after all pictures are taken"
    )
    arguments = parser.parse_args()
    if CHROMIUM is None:
        print("pictures need a browser: apt-get install chromium")
        return 1
    demo_farm = DemoFarm(arguments.folder.resolve())
    if not demo_farm.has_jobs:
        demo_farm.prepare()
        run_jobs(demo_farm)
    zone = demo_farm.read_status()["fleet"]["timezone"]
    with tempfile.TemporaryDirectory() as profile:
        asyncio.run(take_pictures(demo_farm, zone, Path(profile), arguments.only))
    if not arguments.keep:
        demo_farm.clear()
    return 0


if __name__ == "__main__":
    sys.exit(main())
