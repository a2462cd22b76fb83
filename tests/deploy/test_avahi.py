"""The file with which Avahi announces the farm to slicers."""

from pathlib import Path
from xml.etree import ElementTree

from farm.config import WebSection
from farm.web.slicers.octoprint_views import API_VERSION, SERVER_VERSION

SERVICE_FILE = Path(__file__).parents[2] / "deploy" / "avahi" / "farm.service"


def test_announcement_has_the_service_type_and_port_that_slicers_expect():
    (service,) = ElementTree.parse(SERVICE_FILE).getroot().findall("service")
    assert service.findtext("type") == "_octoprint._tcp"
    assert int(service.findtext("port")) == WebSection().address[1]
    records = dict(record.text.split("=") for record in service.findall("txt-record"))
    assert records == {"path": "/", "version": SERVER_VERSION, "api": API_VERSION, "model": "farm"}
