"""Command line of the farm: `main` is the entry point, and imports the module of a command when it is used.

This file imports nothing, so that each command starts quickly.
"""
