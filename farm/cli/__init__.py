"""Command line of the farm: `main` is its entry point, and imports a command when it is used.

This file imports nothing, so that each command starts quickly.
"""
