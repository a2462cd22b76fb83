"""Worker processes, and functions by name that are sent to them."""
