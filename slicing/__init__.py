"""Slicing of plates with CuraEngine, checks of its output, and reading of a person's own G-code.

Public interface: `plate.slice_plate` with its records; the names in the `__init__` of `settings` and
`own_gcode`; `printer`, `errors` and `cache_limit`. This file imports nothing: a program may read an error or
resolve settings without loading numpy and shapely.
"""
