"""Upkeep of the state folder: expired files and events are deleted after each verified backup.

This file imports none of the modules, because each command or worker needs only one of them.
"""
