"""Errors of the farm, with the exit codes of the commands."""

from __future__ import annotations

from enum import IntEnum, StrEnum


class ExitCode(IntEnum):
    """Exit codes of all commands."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    UNREACHABLE = 3
    NO_SUCH_THING = 4
    REFUSED = 5
    JOB_FAILED = 6
    INTERRUPTED = 130


class ErrorCode(StrEnum):
    """Name of an error, in `--json` and in the database."""

    FAILED = "failed"
    FLEET_FILE = "fleet_file"
    UNREACHABLE = "unreachable"
    NO_SUCH_THING = "no_such_thing"
    REFUSED = "refused"
    MODEL = "model"  # the model cannot be read or is not a solid
    NO_FIT = "no_fit"  # no partition of the model fits the printers
    GEOMETRY = "geometry"  # a result violates a geometry rule; nothing is printed
    GCODE = "gcode"  # G-code that a person submitted cannot be printed
    SETTINGS = "settings"  # an option or a Cura setting is not valid
    ENGINE = "engine"  # CuraEngine is missing or failed
    SLICE = "slice"  # a slice was rejected by a check
    LIMIT = "limit"  # processing a model took too much time or memory
    ATTEMPTS = "attempts"  # a plate failed too often
    CANCELLED = "cancelled"


EXIT_CODES: dict[ErrorCode, ExitCode] = {
    ErrorCode.FAILED: ExitCode.FAILED,
    ErrorCode.FLEET_FILE: ExitCode.USAGE,
    ErrorCode.UNREACHABLE: ExitCode.UNREACHABLE,
    ErrorCode.NO_SUCH_THING: ExitCode.NO_SUCH_THING,
    ErrorCode.REFUSED: ExitCode.REFUSED,
    ErrorCode.MODEL: ExitCode.REFUSED,
    ErrorCode.NO_FIT: ExitCode.REFUSED,
    ErrorCode.GEOMETRY: ExitCode.REFUSED,
    ErrorCode.GCODE: ExitCode.REFUSED,
    ErrorCode.SETTINGS: ExitCode.USAGE,
    ErrorCode.ENGINE: ExitCode.FAILED,
    ErrorCode.SLICE: ExitCode.REFUSED,
    ErrorCode.LIMIT: ExitCode.REFUSED,
    ErrorCode.ATTEMPTS: ExitCode.JOB_FAILED,
    ErrorCode.CANCELLED: ExitCode.JOB_FAILED,
}


class FarmError(Exception):
    """Error with a message of one line that names the problem, its place and the remedy."""

    code: ErrorCode = ErrorCode.FAILED

    def __init__(self, message: str, code: ErrorCode | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code

    @property
    def exit_code(self) -> ExitCode:
        return EXIT_CODES[self.code]


class FleetFileError(FarmError):
    """Error about a `fleet.yaml` that is missing, is not YAML, or has a value that is not allowed."""

    code = ErrorCode.FLEET_FILE


class DaemonUnreachable(FarmError):
    """Error of a command whose daemon does not answer."""

    code = ErrorCode.UNREACHABLE


class NotFoundError(FarmError):
    """Error of a command for an unknown job, part, plate or printer."""

    code = ErrorCode.NO_SUCH_THING


class RefusedError(FarmError):
    """Error of a command that is not allowed now."""

    code = ErrorCode.REFUSED
