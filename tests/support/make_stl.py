"""STL files for tests."""

import numpy as np


def stl_bytes(mesh):
    """A mesh as a binary STL, in the middle of the bed and standing on it."""
    mesh = mesh.copy()
    centre = mesh.bounds.mean(axis=0)
    mesh.apply_translation(-np.array([centre[0], centre[1], mesh.bounds[0][2]]))
    return mesh.export(file_type="stl")
