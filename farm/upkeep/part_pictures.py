"""Small pictures of parts, for the report on a job; they are kept when the job's files are deleted."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from farm.state.storage import store_file

log = logging.getLogger(__name__)

_PICTURE_PX = 220


def draw_part(stl: Path) -> bytes | None:
    """Draw a part in its printing pose as a PNG; return None if the file is not a readable STL."""
    import numpy as np  # slow to load, like the imports below
    import trimesh

    from decompose.export import draw_assembly
    from decompose.geometry import Solid
    from decompose.results import Part

    if stl.suffix != ".stl" or not os.access(stl, os.R_OK):
        return None
    mesh = trimesh.load_mesh(stl)
    part = Part("", Solid.from_arrays(mesh.vertices, mesh.faces), np.eye(4), 0.0, "")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.png"
        draw_assembly([part], path, _PICTURE_PX)
        return path.read_bytes()


def store_part_pictures(files: Path, parts: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Draw parts and store their pictures. Call this in a worker, because drawing takes time.

    Parameters
    ----------
    files
        The file store.
    parts
        Name of each part's STL in the store, by the part's id.
    folder
        Folder for temporary files, on the disk of the store.

    Returns
    -------
    dict of str to str
        Name of each part's picture in the store, by the part's id; parts that cannot be drawn are left out.
    """
    pictures = {}
    for part, name in parts.items():
        try:
            png = draw_part(files / name)
        except Exception:  # a failed picture must not stop the deletion of files
            log.exception("part %s cannot be drawn", part)
            continue
        if png is not None:
            temporary = folder / f"picture-{part.replace('/', '-')}.png"
            temporary.write_bytes(png)
            pictures[part] = store_file(files, temporary)
    return pictures
