"""Upkeep of the state folder: expired files and events are deleted after each verified backup.

Nothing is imported here: commands and workers need one module each.
"""
