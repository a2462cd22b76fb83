"""The firmware of the Ultimaker 2 family, a modified Marlin 1.0. Pure.

Source: docs/explanation/ultimaker2-serial.md.
"""

from __future__ import annotations

import re

from drivers.errors import Fault
from drivers.firmware.firmware import Firmware

_CARD_REASON = "belongs to the SD card"

ULTIMAKER2 = Firmware(
    title="Ultimaker 2",
    baud_rate=250_000,
    max_command_bytes=80,
    version_pattern=re.compile(rb"Vers:_([\w.]+?)(?P<suffix>ex)?\s*$", re.MULTILINE),
    home_offset_pattern=re.compile(rb"M206 (X-?\d+\.\d\d Y-?\d+\.\d\d Z-?\d+\.\d\d)\s*$", re.MULTILINE),
    banner_end=b"M301",
    identity_query=b"M115",
    identity_text=b"Ultimaker2",
    settings_query=b"M503",
    position_query=b"M114",
    report_query=b"M105",
    idle_queries=(b"M114", b"M27"),
    # A line with a checksum but no number. The leading newline ends a line that lost its own newline. The
    # second star remains if the first is damaged. The checksum is wrong, so that the firmware refuses a line
    # that was joined to this one.
    last_line_query=b"\n1**0\n",
    last_line_answer=b"Error:No Line Number",
    last_line_query_causes_resend=False,
    acknowledges_read_moves=True,
    ok_details=None,
    busy_prefix=None,
    fault_texts=(
        (b"MAXTEMP", Fault.MAXTEMP),
        (b"MINTEMP", Fault.MINTEMP),
        (b"kill() called", Fault.KILL),
        (b"Printer stopped", Fault.STOPPED),
        (b"Endstop", Fault.ENDSTOP),
        (b"cold extrusion", Fault.COLD_EXTRUSION),
        (b"too long extrusion", Fault.BAD_FILE),
        (b"echo:Marlin", Fault.REBOOT),  # the banner: its ``start`` was lost or garbled
    ),
    stop_command=b"M401",
    halt_command=None,
    reports_executed_steps=True,
    wait_command=b"M400",
    motors_off_command=b"M84",
    heaters_off_commands=(b"M104 S0", b"M140 S0"),
    fan_off_command=b"M107",
    dead_man_command=b"M85 S%d",
    is_dead_man_observed=True,
    setup_commands=(),
    reset_commands=(b"M104 S0", b"M140 S0", b"M401", b"M107", b"G90", b"M82", b"M220 S100", b"M221 S100"),
    wait_timeouts_s={
        b"G28": 1500.0,
        b"G4": 3000.0,
        b"M400": 3000.0,
        b"M401": 300.0,
        b"M84": 3000.0,
        b"M18": 3000.0,
    },
    forbidden_commands={
        b"M0": "waits for the knob forever",
        b"M1": "waits for the knob forever",
        b"M112": "does not exist in this firmware",
        b"M303": "heats beyond the file's targets",
        b"M600": "does not exist in this firmware",
        b"M999": "restarts a board that stopped for a reason",
        b"M85": "sets the farm's dead-man timer",
        b"M110": "sets the link's line number",
        b"G10": "retracts by the printer's own settings, not by the file's",
        b"G11": "retracts by the printer's own settings, not by the file's",
        **{b"M%d" % number: _CARD_REASON for number in (*range(20, 31), 32, 923, 928)},
    },
)
