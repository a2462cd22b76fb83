"""Upkeep of the state folder: what is no longer kept is deleted after each verified backup.

Nothing is imported here: commands and workers need one module each.
"""
