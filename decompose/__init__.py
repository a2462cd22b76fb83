"""Decomposition of a model into parts that are printed in parallel and glued.

Public interface: `decompose.decompose_model`, `auto.decompose_for_goal` and `rebalance.rebalance_planes`;
`options`, `printers`, `errors` and `files`; and the names in the `__init__` of each package. This file
imports nothing, so that a program can import an option or an error without loading the compiler and the
geometry libraries.
"""
