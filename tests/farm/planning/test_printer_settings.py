"""Slicer settings of the fleet's printers."""

from dataclasses import replace

import pytest

from books.decompose_tasks import make_fleet
from farm.errors import RefusedError
from farm.model import JobOptions
from farm.planning.printer_settings import (
    build_settings_request,
    list_matching_printers,
    resolve_printer_settings,
)
from slicing.settings import FARM_QUALITIES, find_resources, resolve_settings


@pytest.mark.parametrize("quality", ["glue", "paper", "fast", "normal", "high"])
def test_parts_get_their_supports_in_every_quality(quality):
    """Enable supports, because poses are chosen for them; Cura's own qualities have none by default."""
    section = make_fleet(1).printers[0]
    settings = resolve_printer_settings(section, quality, find_resources())
    assert settings.support_enabled
    assert settings.support_line_distance_mm > 0.0
    plain_request = replace(build_settings_request(section, quality), has_support=False)
    assert resolve_settings(plain_request, find_resources()).support_enabled == (quality in FARM_QUALITIES)


@pytest.mark.parametrize(
    ("options", "is_enabled", "message"),
    [
        (JobOptions(only=("p0",)), False, "^p0 is disabled: send the file to the address"),
        (JobOptions(only=("p0",), colour="gold"), True, "^p0 is disabled or lacks gold: send"),
        (JobOptions(), False, "^all printers of the fleet are disabled$"),
        (JobOptions(colour="gold"), True, "^no printer of the fleet has gold; the fleet has "),
    ],
)
def test_job_without_a_matching_printer_is_refused_with_the_reason(options, is_enabled, message):
    printers = [section.model_copy(update={"enabled": is_enabled}) for section in make_fleet(1).printers]
    with pytest.raises(RefusedError, match=message):
        list_matching_printers(printers, options)
