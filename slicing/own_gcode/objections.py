"""Reasons to refuse a person's own G-code: at once, or only if the print goes on after the line."""

from __future__ import annotations

from typing import NoReturn

from slicing.errors import GcodeRefused


class Objections:
    """Reasons to refuse a file once something is printed after them.

    A command that must not be in a print is harmless in an end script, which is not printed. Therefore, an
    objection is only recorded, and the file is refused at the next line that prints.

    Attributes
    ----------
    line
        Number of the line that is run.
    is_printing
        Whether the print has begun.
    first_reason
        The first reason why nothing more may be printed; None if there is none.
    """

    def __init__(self) -> None:
        self.line = 0
        self.is_printing = False
        self.first_reason: str | None = None
        self._unconditional_reason: str | None = None  # the first reason before any end script
        self._has_ended = False  # an end script has begun, and nothing has been printed since

    def add(self, reason: str) -> None:
        """Record a reason to refuse the file at its next printed line or its end; ignore start scripts."""
        if self.is_printing:
            self.first_reason = self.first_reason or self._format_reason(reason)
            if not self._has_ended:
                self._unconditional_reason = self._unconditional_reason or self._format_reason(reason)

    def add_except_at_end(self, reason: str, *, ends_print: bool = False) -> None:
        """Record a reason to refuse the file if something is printed after this line (not in an end script).

        Parameters
        ----------
        reason
            Reason why nothing may be printed after the line.
        ends_print
            Whether the line shows that the end script has begun.
        """
        if self.is_printing:
            self.first_reason = self.first_reason or self._format_reason(reason)
            self._has_ended = self._has_ended or ends_print

    def add_mode_change(self, reason: str) -> None:
        """Refuse a command that changes all lines after it, unless it is in an end script."""
        if not self.is_printing:
            self.refuse(reason)
        self.add(reason)

    def refuse(self, reason: str) -> NoReturn:
        """Raise GcodeRefused with the number of the line."""
        raise GcodeRefused(self._format_reason(reason))

    def check_printed_line(self) -> None:
        """Raise GcodeRefused if there is a reason why nothing more may be printed."""
        if self.first_reason is not None:
            raise GcodeRefused(self.first_reason)

    def record_printed_line(self) -> None:
        """Record a printed line: the lines before it were not an end script."""
        self._has_ended = False

    def check_end(self, has_closing_mark: bool) -> None:
        """Check the end of a file that prints something.

        Parameters
        ----------
        has_closing_mark
            Whether the slicer's closing mark comes after the print.

        Raises
        ------
        GcodeRefused
            If there is a reason that no end script excuses, or if the file ends before the print does.
        """
        if self._unconditional_reason is not None:
            raise GcodeRefused(self._unconditional_reason)
        if not (self._has_ended or has_closing_mark):
            self.refuse(
                "the file ends here, before the print does: nothing switches the nozzle off (M104 S0) after "
                "the last line that is printed; export it once more, or copy it again"
            )

    def _format_reason(self, reason: str) -> str:
        return f"line {self.line}: {reason}"
