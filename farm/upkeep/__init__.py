"""Upkeep of the state folder: expired files and events are deleted after each verified backup.

The package imports no module itself, because each command or worker needs only one of them.
"""
