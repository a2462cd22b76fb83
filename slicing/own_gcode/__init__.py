"""Reads a person's own G-code as the firmware would, and writes it anew so that the farm can print it."""
