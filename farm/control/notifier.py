"""Sender of notices to people who are away, through apprise. A thread sends each once, after the commit."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

from pydantic import SecretStr

from farm.errors import FleetFileError
from farm.state import Books
from farm.views import list_due_notices

log = logging.getLogger(__name__)

_MAX_EVENT_AGE_S = 30 * 24 * 3600.0  # farm seconds after which no notice of an event is sent


class Notifier:
    """Sender of notices about new events; a file records sent notices, so that a restart repeats none.

    Parameters
    ----------
    urls
        Addresses in apprise's format. They may contain passwords, so they never appear in messages.
    farm
        The farm's name, which is the title of every message.
    file
        File with the record of sent notices. If it is missing, no notices of earlier events are sent.

    Raises
    ------
    FleetFileError
        If apprise is not installed, or does not know an address.
    """

    def __init__(self, urls: Sequence[SecretStr], farm: str, file: Path, now_s: float) -> None:
        for name in ("apprise", "urllib3"):  # their logs contain addresses
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._channels = [_open_channel(number, url) for number, url in enumerate(urls, 1)]
        self._title, self._file = farm, file
        self._record_start_s, self._sent_notices = _load_record(file, now_s)
        self._queue: SimpleQueue[str] = SimpleQueue()
        # A daemon thread, because an address that does not answer must not delay the exit.
        Thread(target=self._send_notices, name="notify", daemon=True).start()
        self._save_record()

    def notify(self, books: Books, now_s: float) -> None:
        """Queue the notices that are due according to the committed books; a thread sends them."""
        notices = list_due_notices(books, now_s, self._record_start_s, self._sent_notices)
        if not notices:
            return
        self._record_start_s = max(self._record_start_s, now_s - _MAX_EVENT_AGE_S)
        self._sent_notices = {
            key: at_s for key, at_s in self._sent_notices.items() if at_s >= self._record_start_s
        }
        self._sent_notices |= {notice.key: notice.at_s for notice in notices}
        self._save_record()  # before sending: a lost notice is better than a duplicate
        self._queue.put("\n".join(notice.text for notice in notices))

    def on_clock_set(self, step_s: float) -> None:
        """Move the start of the record back if the clock was set back, so that new events cause notices."""
        self._record_start_s = min(self._record_start_s, self._record_start_s + step_s)

    def _save_record(self) -> None:
        temporary = self._file.with_suffix(".half")
        try:
            temporary.write_text(json.dumps({"since_s": self._record_start_s, "told": self._sent_notices}))
            temporary.replace(self._file)
        except OSError as error:
            log.warning("%s: cannot be written (%s): some notices may be sent twice", self._file, error)

    def _send_notices(self) -> None:
        while True:
            body = self._queue.get()
            for number, channel in enumerate(self._channels, 1):
                try:
                    is_sent = channel.notify(title=self._title, body=body)
                except Exception as error:  # from a plugin; the text may contain the address
                    is_sent = False
                    log.warning("notify: address %d: %s", number, type(error).__name__)
                if not is_sent:
                    log.warning("notify: address %d was not reached", number)


def delete_record(file: Path) -> None:
    """Delete the record of sent notices. A notifier that starts later sends no notices of earlier events."""
    file.unlink(missing_ok=True)


def _open_channel(number: int, url: SecretStr) -> Any:
    try:
        from apprise import Apprise
    except ImportError as error:
        raise FleetFileError("fleet.notify: needs apprise: `pip install 'farm[notify]'`") from error
    channel = Apprise()
    if not channel.add(url.get_secret_value()):
        raise FleetFileError(
            f"fleet.notify: apprise does not know address {number}: see its list of services"
        )
    return channel


def _load_record(file: Path, now_s: float) -> tuple[float, dict[str, float]]:
    try:
        record = json.loads(file.read_text())
        return min(float(record["since_s"]), now_s), {
            str(key): float(at_s) for key, at_s in record["told"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return now_s, {}
