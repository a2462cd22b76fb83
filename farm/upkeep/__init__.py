"""Upkeep of the state folder: expired files and events are deleted after each verified backup.

This file does not import the modules of the package, because a command or a worker needs only one of them.
"""
