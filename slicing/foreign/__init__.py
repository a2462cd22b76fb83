"""A person's own G-code: read as the firmware would, and written anew so that the farm can print it."""
