"""Software versions on two computers, and the first one that differs."""

from dataclasses import replace

import pytest

from farm.compute.cluster.installation import Installation

INSTALLATION = Installation(
    "1 (aa)", "4.13.0 (bb)", "cc", "numpy 2.1, scipy 1.17", "/usr/bin/cura", "/cura", ""
)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, None),
        ({"engine_path": "/opt/cura"}, None),
        ({"farm": "2 (aa)"}, "it has farm 2 (aa), not 1 (aa)"),
        ({"engine": "5.0 (dd)"}, "it has CuraEngine 5.0 (dd), not 4.13.0 (bb)"),
        ({"settings": "ee"}, "it has Cura's settings ee, not cc"),
        ({"libraries": "numpy 2.2, scipy 1.17"}, "it has numpy 2.2, not numpy 2.1"),
    ],
)
def test_difference_is_named(changes, reason):
    assert replace(INSTALLATION, **changes).describe_difference(INSTALLATION) == reason


def test_record_of_another_version_of_farm_is_refused():
    other_installation = Installation.from_record({"farm": "0.0.1", "engine_v": "4"})
    assert other_installation.describe_difference(INSTALLATION) == "it has farm 0.0.1, not 1 (aa)"
    assert Installation.from_record(INSTALLATION.as_record()) == INSTALLATION
