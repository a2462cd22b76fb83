"""Emergency stop, heater watch, abort sequence and mains switch."""

from drivers.safety.abort import send_abort, send_abort_until_accepted
from drivers.safety.estop import (
    ProgressCallback,
    StopResult,
    StopTarget,
    list_targets,
    stop_board,
    stop_printer,
)
from drivers.safety.heater_watch import Finding, HeaterWatch
from drivers.safety.mains import NO_COMMAND_OUTCOME, POLL_INTERVAL_S, PowerOffRun, cut_mains

__all__ = [
    "NO_COMMAND_OUTCOME",
    "POLL_INTERVAL_S",
    "Finding",
    "HeaterWatch",
    "PowerOffRun",
    "ProgressCallback",
    "StopResult",
    "StopTarget",
    "cut_mains",
    "list_targets",
    "send_abort",
    "send_abort_until_accepted",
    "stop_board",
    "stop_printer",
]
