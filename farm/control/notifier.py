"""Tells people who are not there, through apprise: after the commit, once, and nothing waits for it."""

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
from farm.state.books import Books
from farm.views.notices import list_due_notices

log = logging.getLogger(__name__)

_KEPT_S = 30 * 24 * 3600.0  # farm seconds after which nothing is news any more


class Notifier:
    """What was told is kept in a file, so that no restart tells it again.

    Parameters
    ----------
    urls
        Where to, as apprise writes it. They may hold passwords: nothing here says them.
    farm
        The farm's name: the title of every message.
    file
        What was told. Where there is none, nothing that happened before is news.

    Raises
    ------
    FleetFileError
        Where apprise is not installed, or does not know an address.
    """

    def __init__(self, urls: Sequence[SecretStr], farm: str, file: Path, now_s: float) -> None:
        for name in ("apprise", "urllib3"):  # they log addresses
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._ways = [_way(number, url) for number, url in enumerate(urls, 1)]
        self._title, self._file = farm, file
        self._since_s, self._told = _recall(file, now_s)
        self._waiting: SimpleQueue[str] = SimpleQueue()
        # A thread that dies with the process: an address that does not answer keeps no daemon alive.
        Thread(target=self._send, name="notify", daemon=True).start()
        self._keep()

    def tell(self, books: Books, now_s: float) -> None:
        """Have told what is news in these books, which are committed. Returns at once."""
        news = list_due_notices(books, now_s, self._since_s, self._told)
        if not news:
            return
        self._since_s = max(self._since_s, now_s - _KEPT_S)
        self._told = {key: at_s for key, at_s in self._told.items() if at_s >= self._since_s}
        self._told |= {one.key: one.at_s for one in news}
        self._keep()  # first: rather not at all than twice
        self._waiting.put("\n".join(one.text for one in news))

    def clock_set(self, by_s: float) -> None:
        """What happens from now on is news, also where the clock that tells when was set back."""
        self._since_s = min(self._since_s, self._since_s + by_s)

    def _keep(self) -> None:
        half = self._file.with_suffix(".half")
        try:
            half.write_text(json.dumps({"since_s": self._since_s, "told": self._told}))
            half.replace(self._file)
        except OSError as error:
            log.warning("%s: cannot be written (%s): some notices may be sent twice", self._file, error)

    def _send(self) -> None:
        while True:
            body = self._waiting.get()
            for number, way in enumerate(self._ways, 1):
                try:
                    sent = way.notify(title=self._title, body=body)
                except Exception as error:  # a plugin's own: its words may hold the address
                    sent = False
                    log.warning("notify: address %d: %s", number, type(error).__name__)
                if not sent:
                    log.warning("notify: address %d was not reached", number)


def forget(file: Path) -> None:
    """Nobody is told any more: what happens until somebody is again is no news then."""
    file.unlink(missing_ok=True)


def _way(number: int, url: SecretStr) -> Any:
    try:
        from apprise import Apprise
    except ImportError as error:
        raise FleetFileError("fleet.notify: needs apprise: `pip install 'farm[notify]'`") from error
    way = Apprise()
    if not way.add(url.get_secret_value()):
        raise FleetFileError(
            f"fleet.notify: apprise does not know address {number}: see its list of services"
        )
    return way


def _recall(file: Path, now_s: float) -> tuple[float, dict[str, float]]:
    try:
        kept = json.loads(file.read_text())
        return min(float(kept["since_s"]), now_s), {
            str(key): float(at_s) for key, at_s in kept["told"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return now_s, {}
