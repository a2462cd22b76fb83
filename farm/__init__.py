"""farm: a fleet of Ultimaker 2+ printers as one fast printer for large models."""

from importlib.metadata import version

__version__ = version("farm")
