"""Files in an agent's folder: what it was started with, and its journal."""
