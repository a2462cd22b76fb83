"""A printer's camera for callers on the network."""

import pytest

from farm.api import NETWORK_PREFIX
from farm.cameras.image import read_image
from farm.errors import ErrorCode, FarmError
from farm.model import Role
from farms.network_farm import NetworkFarm
from hosts.fake_camera import make_png

CAMERA_PATH = f"{NETWORK_PREFIX}/printers/a/camera"


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


def set_camera(farm, fetch_still):
    # The services are frozen, because routes only read them.
    object.__setattr__(farm.services, "fetch_still", fetch_still)


def test_still_is_sent_as_an_image_that_is_not_cached(farm):
    async def fetch_still(printer):
        assert printer == "a"
        return read_image(make_png())

    set_camera(farm, fetch_still)
    response = farm.ask("GET", CAMERA_PATH, farm.add_key(Role.LOOK).text)
    assert (response.status_code, response.content) == (200, make_png())
    assert response.headers["content-type"] == "image/png"
    assert response.headers["cache-control"] == "no-store"
    assert response.headers["x-content-type-options"] == "nosniff"


def test_unanswered_camera_request_gets_status_503(farm):
    async def fetch_still(printer):
        raise FarmError(f"the camera of {printer}: it does not answer", ErrorCode.UNREACHABLE)

    set_camera(farm, fetch_still)
    response = farm.ask("GET", CAMERA_PATH, farm.add_key(Role.LOOK).text)
    assert (response.status_code, response.json()["error"]) == (503, "the camera of a: it does not answer")


def test_printer_without_a_camera_gets_status_404(farm):
    response = farm.ask("GET", CAMERA_PATH, farm.add_key(Role.LOOK).text)
    assert response.status_code == 404 and "no camera" in response.json()["error"]
