"""A real daemon that is killed again and again, and started again each time, as systemd does.

    python kept_daemon.py FATES FARM-WORDS...

FATES is JSON, of each life in turn: a moment, and of which event's first commit; or `later`, and after how
many seconds. The life after the last of these goes on. What each died at is told. A life is cheap: it is
forked off a process that has imported all of it, and what workers do is done in it.
"""

import itertools
import json
import os
import signal
import sys
import threading

import farm.daemon
from farm.cli.main import main
from farm.state.storage.store import Store

MOMENTS = ("before", "within", "after")
"""Before the transaction begins, with all of it written but its COMMIT, and when it is on the disk."""
LATER = "later"


class NoWorkers:
    """Stand-in for the daemon's worker processes."""

    starting = None
    has_idle = True
    memory_bytes = 2**40

    def __init__(self, *_):
        pass

    async def run(self, work, *args, limit=None, group=None):
        return work(*args)

    def close(self):
        pass


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def tell(*arguments):
    os.write(sys.stdout.fileno(), f"dies {' '.join(arguments)}\n".encode())


def schedule_death(moment, what):
    """Make this process die at a commit or at a time."""
    if moment == LATER:
        threading.Timer(what, lambda: (tell(LATER), die())).start()
        return
    commit = Store.commit

    def last(store, event, before, after):
        if type(event).__name__ != what:
            commit(store, event, before, after)
            return
        tell(moment, what)
        if moment == "before":
            die()
        if moment == "within":
            store._db.set_trace_callback(lambda sql: die() if sql == "COMMIT" else None)
        commit(store, event, before, after)
        die()

    Store.commit = last


def live(fate):
    """Process of a daemon that dies at a given commit."""
    pid = os.fork()
    if pid == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if fate is not None:
            schedule_death(*fate)
        main()
        os._exit(0)
    return pid


def keep(fates):
    """Start daemons one after another until one ends by itself or this process is ended."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    farm.daemon.Workers = NoWorkers
    for fate in itertools.chain(fates, itertools.repeat(None)):
        pid = live(fate)
        try:
            _, status = os.waitpid(pid, 0)
        except SystemExit:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise
        if not os.WIFSIGNALED(status):
            return


if __name__ == "__main__":
    _, reported, *sys.argv[1:] = sys.argv
    keep(json.loads(reported))
