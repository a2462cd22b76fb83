"""A person's own G-code, read by the firmware's rules and rewritten for printing on the farm."""

from slicing.gcode_lines import MAX_LINE_BYTES, quote_text
from slicing.own_gcode.acceptance import AcceptedGcode, accept_gcode
from slicing.own_gcode.target import PrintTarget
from slicing.own_gcode.writer import TimeEstimator

__all__ = ["MAX_LINE_BYTES", "AcceptedGcode", "PrintTarget", "TimeEstimator", "accept_gcode", "quote_text"]
