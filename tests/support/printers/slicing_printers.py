"""Printer models to slice for, as the farm passes them to the slicing package."""

from drivers.printers import SLICING_PROFILES
from farm.planning.printer_settings import build_slicing_printer

PRINTERS = {model: build_slicing_printer(profile) for model, profile in SLICING_PROFILES.items()}
UM2_PLUS = PRINTERS["ultimaker2_plus"]
