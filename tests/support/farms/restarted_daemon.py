"""A real daemon that is killed repeatedly and restarted each time, as by systemd.

    python restarted_daemon.py DEATHS FARM-ARGUMENTS...

DEATHS is a JSON list with one item for each daemon in turn. The item `[MOMENT, EVENT]` kills the daemon at
its first commit of this event; `["later", SECONDS]` kills it after this time. The daemon after the last item
survives. Each death is reported. To start quickly, each daemon is forked from a process that has imported all
modules, and executes the tasks of workers itself.
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

DEATH_MOMENTS = ("before", "within", "after")
"""Moments of a death: before the transaction, before its COMMIT, and after the data is on the disk."""
AFTER_DELAY = "later"


class InlineWorkers:
    """Stand-in for the daemon's worker processes that runs each task in the daemon."""

    start_step = None
    has_idle_worker = True
    memory_bytes = 2**40

    def __init__(self, *_):
        pass

    async def run(self, work, *args, limit=None, group=None):
        return work(*args)

    def close(self):
        pass


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def report_death(*arguments):
    os.write(sys.stdout.fileno(), f"dies {' '.join(arguments)}\n".encode())


def schedule_death(moment, event_or_delay_s):
    """Make this process die at a commit or at a time."""
    if moment == AFTER_DELAY:
        threading.Timer(event_or_delay_s, lambda: (report_death(AFTER_DELAY), die())).start()
        return
    commit = Store.commit

    def commit_until_death(store, event, old_books, new_books):
        if type(event).__name__ != event_or_delay_s:
            commit(store, event, old_books, new_books)
            return
        report_death(moment, event_or_delay_s)
        if moment == "before":
            die()
        if moment == "within":
            store._db.set_trace_callback(lambda sql: die() if sql == "COMMIT" else None)
        commit(store, event, old_books, new_books)
        die()

    Store.commit = commit_until_death


def start_daemon(death):
    """Fork a daemon that dies as scheduled, or never if `death` is None; return its process id."""
    pid = os.fork()
    if pid == 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if death is not None:
            schedule_death(*death)
        main()
        os._exit(0)
    return pid


def run_daemons(deaths):
    """Start daemons one after another until one ends by itself or this process is terminated."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    farm.daemon.WorkerPool = InlineWorkers
    for death in itertools.chain(deaths, itertools.repeat(None)):
        pid = start_daemon(death)
        try:
            _, status = os.waitpid(pid, 0)
        except SystemExit:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise
        if not os.WIFSIGNALED(status):
            return


if __name__ == "__main__":
    _, deaths_text, *sys.argv[1:] = sys.argv
    run_daemons(json.loads(deaths_text))
