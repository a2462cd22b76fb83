"""STL files for tests."""

import numpy as np


def write_stl_bytes(mesh):
    """Write a mesh as a binary STL, centred on the bed."""
    mesh = mesh.copy()
    centre = mesh.bounds.mean(axis=0)
    mesh.apply_translation(-np.array([centre[0], centre[1], mesh.bounds[0][2]]))
    return mesh.export(file_type="stl")
