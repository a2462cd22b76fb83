"""A person's own G-code: read by the firmware's rules, and written anew so that the farm can print it."""

from slicing.gcode_lines import LONGEST, shown
from slicing.own_gcode.accept import ForeignGcode, accept
from slicing.own_gcode.target import PrintTarget
from slicing.own_gcode.writer import Stopwatch

__all__ = ["LONGEST", "ForeignGcode", "PrintTarget", "Stopwatch", "accept", "shown"]
