"""Unmodified Marlin 2, which runs on printers of many makers. Pure.

Sources are Marlin's source files, which the comments name. Nothing here was measured on a printer: it is all
[assumed] to hold for a real one.
"""

from __future__ import annotations

import re

from drivers.errors import Fault
from drivers.firmware.firmware import Firmware

_CARD_REASON = "belongs to the SD card"
_MODE_REASON = "the firmware forgets it at the next G90 or G91"
_SETUP_COMMANDS = (
    b"M113 S1",  # a busy message every second instead of every two seconds
    b"M84 S10800",  # the default of 2 minutes without a move would switch the motors off in a pause
)

MARLIN2 = Firmware(
    title="Marlin 2",
    baud_rate=115_200,
    max_command_bytes=80,  # ``MAX_CMD_SIZE`` is 96
    version_pattern=None,  # the banner is the same for many makers
    home_offset_pattern=re.compile(rb"M206 (X-?\d+\.\d\d Y-?\d+\.\d\d Z-?\d+\.\d\d)\s*$", re.MULTILINE),
    banner_end=None,  # its last line depends on the build options
    identity_query=b"M115",
    identity_text=b"FIRMWARE_NAME:Marlin 2",
    settings_query=b"M503",
    position_query=b"M114",
    report_query=b"M105",
    idle_queries=(b"M114", b"M27"),
    # ``GCodeQueue::get_serial_commands`` (gcode/queue.cpp) refuses a number without a checksum before any
    # effect, and accepts any line number for an M110. The leading newline ends a line that lost its newline.
    last_line_query=b"\nN0 M110\n",
    last_line_answer=b"Error:No Checksum with line number",
    last_line_query_causes_resend=True,  # ``gcode_line_error``
    acknowledges_read_moves=False,  # ``GcodeSuite::process_parsed_command`` ends with its ok
    ok_details=re.compile(rb"(?: N(\d{1,9}))? P\d{1,3} B\d{1,3}"),  # ``ADVANCED_OK``
    busy_prefix=b"echo:busy:",  # ``GcodeSuite::host_keepalive``
    fault_texts=(
        (b"MAXTEMP", Fault.MAXTEMP),
        (b"MINTEMP", Fault.MINTEMP),
        (b"Thermal Runaway", Fault.THERMAL_RUNAWAY),
        (b"Heating failed", Fault.HEATER_TIMEOUT),
        (b"KILL caused", Fault.KILL),  # its dead-man timer
        (b"kill() called", Fault.KILL),
        (b"Printer stopped", Fault.STOPPED),
        (b"STOP called", Fault.STOPPED),
        (b"busy: paused", Fault.STOPPED),  # waits for a person, for instance because the filament has run out
        (b"Homing Failed", Fault.ENDSTOP),
        (b"cold extrusion", Fault.COLD_EXTRUSION),
        (b"too long extrusion", Fault.BAD_FILE),
        (b"echo:Marlin", Fault.REBOOT),  # the banner: its ``start`` was lost or garbled
        (b"echo:Compiled:", Fault.REBOOT),
    ),
    stop_command=b"M410",  # M401 lowers a probe here
    halt_command=b"M112",
    reports_executed_steps=False,  # ``report_current_position_projected``: the planned position
    wait_command=b"M400",
    motors_off_command=b"M84",
    heaters_off_commands=(b"M104 S0", b"M140 S0"),
    fan_off_command=b"M107",
    # The timer is reset only by moves and by M85 itself (``manage_inactivity``); it ends in kill().
    dead_man_command=b"M85 S%d",
    is_dead_man_observed=False,
    setup_commands=_SETUP_COMMANDS,
    reset_commands=(
        b"M104 S0",
        b"M140 S0",
        b"M410",
        b"M107",
        b"G90",
        b"M82",
        b"M220 S100",
        b"M221 S100",
        *_SETUP_COMMANDS,
    ),
    wait_timeouts_s={
        b"G28": 1500.0,
        b"G4": 3000.0,
        b"M400": 3000.0,
        b"M410": 300.0,
        b"M84": 3000.0,
        b"M18": 3000.0,
    },
    forbidden_commands={
        b"M0": "waits for a person forever",
        b"M1": "waits for a person forever",
        b"M125": "waits for a person forever",
        b"M226": "waits for a switch forever",
        b"M600": "waits for a person forever",
        b"M83": _MODE_REASON,
        b"M108": "interrupts the wait for a temperature",
        b"M410": "ends all moves",
        b"M112": "switches the board off",
        b"M81": "switches the power off",
        b"M303": "heats beyond the file's targets",
        b"M999": "restarts a board that stopped for a reason",
        b"M85": "sets the farm's dead-man timer",
        b"M110": "sets the link's line number",
        b"M113": "sets the interval of busy messages, which the link depends on",
        b"M155": "sends reports that were not requested",
        b"M401": "lowers the probe",
        b"M402": "raises the probe",
        b"G10": "retracts by the printer's own settings, not by the file's",
        b"G11": "retracts by the printer's own settings, not by the file's",
        **{b"M%d" % number: _CARD_REASON for number in (*range(20, 31), 32, 524, 808, 928)},
    },
)
