"""Inspection of submissions and of the fleet file, before anything is planned."""
