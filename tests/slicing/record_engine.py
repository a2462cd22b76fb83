"""Record the log and the G-code of a version of CuraEngine, for tests on computers without that version.

Run the script with that version and its files, from the root of the repository. On Debian 13 (``apt-get
install cura-engine cura fdm-materials``), or with those packages unpacked in a chroot::

    FARM_CURA_ENGINE=/usr/bin/CuraEngine FARM_CURA_RESOURCES=/usr/share/cura/resources \\
        python -m tests.slicing.record_engine tests/slicing/fixtures/engine-5.0.json.gz
"""

import base64
import dataclasses
import gzip
import json
import sys
import tempfile
from pathlib import Path

import trimesh

from printers.slicing_printers import UM2_PLUS
from slicing.engine import EngineLimits, read_engine_version, run_engine
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

make_translation = trimesh.transformations.translation_matrix


def make_model():
    """Make a plate with a hole, a fin as wide as one line, and a post."""
    plate = trimesh.creation.box((14, 14, 2), make_translation((0, 0, 1)))
    fin = trimesh.creation.box((0.3, 10, 2), make_translation((-5.5, 0, 3)))
    post = trimesh.creation.cylinder(1.2, 2, sections=24, transform=make_translation((5, 5, 3)))
    hole = trimesh.creation.cylinder(3, 9, sections=32)
    return trimesh.boolean.difference([trimesh.boolean.union([plate, fin, post]), hole])


def main():
    settings = resolve_settings(SettingsRequest(UM2_PLUS), find_resources())
    engine = find_engine()
    stl = make_model().export(file_type="stl")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.stl"
        path.write_bytes(stl)
        result = run_engine(engine, path, settings.global_, settings.extruder, EngineLimits(30, 60.0))
    record = {
        "version": read_engine_version(engine),
        "settings": dataclasses.asdict(settings),
        "stl": base64.b64encode(stl).decode(),
        "gcode": result.gcode.decode(),
        "log": result.log,
    }
    Path(sys.argv[1]).write_bytes(gzip.compress(json.dumps(record).encode(), 9, mtime=0))


if __name__ == "__main__":
    main()
