"""Sizes of the pages that are sent, and of the files that they load."""

import gzip

import pytest

from books.planned_job import plan_job
from farm import api
from farm.model import Role
from farm.web.live import prepare_page
from farm.web.notes import User
from farm.web.pages.home import render_home
from farm.web.pages.static_files import load_static_files
from farms.network_farm import NetworkFarm

MAX_FIRST_PAGE_BYTES, MAX_BYTES_WITH_VIEWER = 60_000, 250_000


def test_first_page_of_a_hundred_printers_is_small(tmp_path):
    farm = NetworkFarm(tmp_path)
    key = farm.add_key(Role.OPERATE).text
    status = api.Status.model_validate(farm.ask("GET", "/api/v1/status", key).json())
    farm.store.close()
    progress = api.PrintProgress(
        job=1, plate="1/01", state="printing", progress=0.5, remaining_s=4000.0, layers=9, pause_ends=None
    )
    printers = [
        status.printers[0].model_copy(
            update={"name": f"um2-{index:03d}", "print": progress, "nozzle_c": 180.0 + index, "bed_c": 60.0}
        )
        for index in range(100)
    ]
    page = prepare_page(
        render_home(status.model_copy(update={"printers": printers}), User("a", Role.OPERATE))
    )
    loaded_files = [file for name, file in load_static_files().items() if f"/static/{name}?" in page]
    assert len(loaded_files) >= 4  # style sheet, icon and scripts
    size_bytes = len(gzip.compress(page.encode())) + sum(
        len(file.compressed_content) for file in loaded_files
    )
    assert size_bytes < MAX_FIRST_PAGE_BYTES


def test_viewer_script_is_small():
    viewer = load_static_files().get("viewer.js")
    if viewer is None:
        pytest.skip("the viewer is not built: `make pages`")
    assert len(viewer.compressed_content) < MAX_BYTES_WITH_VIEWER - MAX_FIRST_PAGE_BYTES


def test_page_is_compressed_for_clients_that_read_it(tmp_path):
    farm = NetworkFarm(tmp_path)
    session = farm.open_session()
    page = farm.browse("GET", "/", session)
    assert page.headers["content-encoding"] == "gzip"
    assert page.headers["vary"].lower() == "accept-encoding"
    plain_page = farm.browse("GET", "/", session, {"accept-encoding": "identity"})
    assert "content-encoding" not in plain_page.headers
    assert int(plain_page.headers["content-length"]) == len(plain_page.content)
    assert plain_page.text == page.text
    assert "content-encoding" not in farm.ask("GET", "/healthz").headers
    farm.store.close()


def test_files_of_jobs_are_sent_uncompressed(tmp_path):
    farm = NetworkFarm(tmp_path)
    plan_job(farm, glb=b"glTF" * 1000)
    (farm.state.files / "g.gcode").write_bytes(b"G1 X1\n" * 1000)
    (farm.state.files / "p.stl").write_bytes(b"solid " * 1000)
    session = farm.open_session()
    for name in ("plate-01.gcode", "p01.stl", "assembly.glb"):
        response = farm.browse("GET", f"/api/v1/jobs/1/files/{name}", session)
        assert "content-encoding" not in response.headers, (name, response.headers)
        assert int(response.headers["content-length"]) == len(response.content) >= 4000
    farm.store.close()
