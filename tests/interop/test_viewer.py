"""The 3D views in Chromium; skipped if Chromium or three.js is missing."""

import asyncio

import numpy as np
import pytest
import trimesh

from books.planned_job import plan_job
from browser.chromium import CHROMIUM, Chromium
from decompose.export import write_glb
from decompose.geometry import Solid
from decompose.results import Part
from farm.control import JobCommands, PrinterCommands
from farm.model import Role
from farm.web.pages.static_files import load_static_files
from farms.network_farm import HOST, NetworkFarm
from farms.served_farm import serve
from model_files.make_3mf import pack_3mf, write_mesh_xml, write_model_xml, write_object_xml

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is missing: apt-get install chromium"),
    pytest.mark.skipif("viewer.js" not in load_static_files(), reason="the viewer is not built: make pages"),
]
WINDOW_PX = (1000, 700)
STATUS_TEXT = "document.querySelector('#viewer [role=status]').textContent"
LEGEND_TEXT = (
    "[...document.querySelectorAll('#viewer .key span')].map((element) => element.textContent.trim()).join()"
)


@pytest.fixture
def glb(tmp_path):
    """Return a GLB file of two boxes side by side."""
    boxes = [Solid.box((x, 0.0, 0.0), (x + 40.0, 60.0, 50.0)) for x in (0.0, 40.0)]
    parts = [Part(f"p{n:02d}", box, np.eye(4), 0.0, "a") for n, box in enumerate(boxes, 1)]
    write_glb(parts, tmp_path / "a.glb")
    return (tmp_path / "a.glb").read_bytes()


def run_in_browser(tmp_path, scenario, **job):
    """Run a scenario in a browser in which ann has logged in."""

    async def run():
        farm = NetworkFarm(tmp_path)
        if job:
            plan_job(farm, **job)
        async with (
            serve(farm) as (port, _),
            Chromium(tmp_path / "profile", f"MAP {HOST} 127.0.0.1") as browser,
        ):
            base = f"http://127.0.0.1:{port}"
            await browser.open(f"{base}/login/{farm.sessions.make_link('ann', Role.OPERATE)}")
            await browser.press("button")
            await scenario(browser, base, *([farm] if job else []))
            assert not [message for message in browser.messages if "Content Security Policy" in message]
        farm.store.close()

    asyncio.run(run())


def test_click_on_a_row_or_on_a_part_selects_both(tmp_path, glb):
    async def scenario(browser, base, _):
        await browser.open(f"{base}/jobs/1")
        await browser.wait_for("document.querySelector('#viewer canvas') !== null")
        assert await browser.evaluate("document.querySelector('#viewer img')") is None
        assert await browser.evaluate(LEGEND_TEXT) == "printing,waiting"
        await browser.evaluate("document.querySelectorAll('#viewer [type=radio]')[1].click()")
        assert await browser.evaluate(LEGEND_TEXT) == "a"  # the printer of both parts in the forecast
        await browser.evaluate("document.querySelector('#p02 th button').click()")
        picked_row = "document.querySelector('tr.picked').id"
        assert await browser.evaluate(picked_row) == "p02"
        assert await browser.evaluate(STATUS_TEXT) == "p02: waiting, a"
        await browser.evaluate("document.querySelector('#viewer').scrollIntoView()")
        area = "document.querySelector('#viewer canvas').getBoundingClientRect()"
        left, top, width, height = [
            await browser.evaluate(f"{area}.{side}") for side in ("left", "top", "width", "height")
        ]
        await browser.click(left + 0.35 * width, top + 0.5 * height)
        assert await browser.evaluate(picked_row) == "p01"
        await browser.click(left + 2, top + 2)  # outside all parts
        assert await browser.evaluate("document.querySelector('tr.picked')") is None

    run_in_browser(tmp_path, scenario, glb=glb)


def test_part_of_a_job_with_copies_has_a_row_for_each_copy(tmp_path, glb):
    async def scenario(browser, base, _):
        await browser.open(f"{base}/jobs/1")
        await browser.wait_for("document.querySelector('#viewer canvas') !== null")
        await browser.evaluate("document.querySelectorAll('#viewer [type=radio]')[0].click()")
        assert await browser.evaluate(LEGEND_TEXT) == "copies with several states,waiting"
        await browser.evaluate("document.querySelector('tr[data-part=\"p02.2\"] th button').click()")
        assert await browser.evaluate("document.querySelector('tr.picked').id") == "p02.2"
        assert (await browser.evaluate(STATUS_TEXT)).startswith("p02.2: ")

    run_in_browser(tmp_path, scenario, glb=glb, copies=2)


def test_view_remains_while_the_state_of_the_job_changes(tmp_path, glb):
    async def scenario(browser, base, farm):
        await browser.open(f"{base}/jobs/1")
        await browser.wait_for("document.querySelector('#viewer canvas') !== null")
        await browser.evaluate("window.isSame = true; document.querySelector('#p02 th button').click()")
        jobs = JobCommands(farm.controller, PrinterCommands(farm.controller))
        jobs.set_paused(1, True, "bob")
        await browser.wait_for("document.querySelector('#state').textContent.includes('Paused')")
        assert await browser.evaluate("window.isSame && document.querySelector('#viewer canvas') !== null")
        assert await browser.evaluate("document.querySelector('tr.picked th button').textContent") == "p02"

    run_in_browser(tmp_path, scenario, glb=glb)


def test_picture_remains_if_the_model_is_not_glb(tmp_path):
    async def scenario(browser, base, _):
        await browser.open(f"{base}/jobs/1")
        await browser.wait_for("document.querySelector('#viewer img') !== null")
        assert "p02" in await browser.read_text()

    run_in_browser(tmp_path, scenario, glb=b"no glb")


def export_model(mesh, kind):
    """Return a mesh as the bytes of a file; 3MF files are in inches."""
    if kind == "3mf":
        return pack_3mf(
            write_model_xml([write_object_xml(1, write_mesh_xml(mesh))], ['objectid="1"'], "inch")
        )
    content = mesh.export(file_type=kind)
    return content if isinstance(content, bytes) else content.encode()


@pytest.mark.parametrize(
    ("name", "unit", "expected"),
    [
        ("a.stl", "1", "20 × 30 × 100 mm. It may fit as one part on Ultimaker 2+."),
        ("a.obj", "10", "200 × 300 × 1000 mm. It is larger than any printer: it is cut into parts."),
        ("a.ply", "1", "20 × 30 × 100 mm. It may fit as one part on Ultimaker 2+."),
        ("a.3mf", "1", "508 × 762 × 2540 mm. It is larger than any printer: it is cut into parts."),  # inches
    ],
)
def test_size_of_a_chosen_model_is_shown_before_it_is_sent(tmp_path, name, unit, expected):
    path = tmp_path / name
    path.write_bytes(export_model(trimesh.creation.box((20.0, 30.0, 100.0)), path.suffix[1:]))

    async def scenario(browser, base):
        await browser.open(f"{base}/submit")
        await browser.evaluate(f"document.querySelector('[name=scale]').value = '{unit}'")
        await browser.choose_file("[name=file]", path)
        await browser.wait_for("document.getElementById('size').textContent !== ''")
        assert await browser.evaluate("document.getElementById('size').textContent") == expected
        assert await browser.evaluate("document.querySelector('#viewer canvas') !== null")

    run_in_browser(tmp_path, scenario)
