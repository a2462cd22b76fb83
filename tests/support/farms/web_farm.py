"""A farm with idle printers, and callers on the network."""

import asyncio

import httpx

from books.recording_controller import Farm
from browser.http_caller import DAEMON_USER, call_as
from clusters.same_process import AcceptingWorkers
from drivers.clock import Clock
from farm.api import NETWORK_PREFIX, KeyRequest
from farm.control import DryRuns, KeyCommands
from farm.http import EventStreams, Services, make_app
from farm.paths import StateFolder
from farm.web import make_web_app

HOST = "farm.lab.example"


class WebFarm(Farm):
    """A farm whose printers `a` and `b` are idle and clear, with both applications of its daemon."""

    def __init__(self, folder, workers=None, **fleet_options):
        state = StateFolder(folder / "state")
        state.make()
        super().__init__(state.root, clock=Clock(), **fleet_options)
        self.report_ready("a", "b")
        self.state = state
        self.services = Services(
            self.controller,
            state,
            folder / "fleet.yaml",
            workers or AcceptingWorkers(),
            self._refuse_shutdown,
            streams=EventStreams(self.store, poll_interval_s=0.0),
        )
        self.web = make_web_app(self.services, DryRuns(self.controller), {HOST})
        self.unix = call_as(DAEMON_USER, make_app(self.services, DryRuns(self.controller)))
        self.keys = KeyCommands(self.controller)

    async def _refuse_shutdown(self, now):
        raise AssertionError("no test shuts this farm down")

    def add_key(self, role, name=None):
        """Return a new key with a role."""
        return self.keys.add(KeyRequest(name=name or str(role), role=role), "ann")

    def ask(self, method, path, key=None, headers=None, **options):
        """Send a request over the network, with or without a key."""
        key_header = {"x-api-key": key.text} if key else {}
        return self._call(self.web, method, path, {**key_header, **(headers or {})}, **options)

    def ask_socket(self, method, path, **options):
        """Send a request over the Unix socket."""
        return self._call(self.unix, method, path, {}, **options)

    @staticmethod
    def _call(app, method, path, headers, **options):
        async def call():
            transport = httpx.ASGITransport(app, client=("10.0.0.9", 1), raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url=f"http://{HOST}") as client:
                return await client.request(method, path, headers=headers, **options)

        return asyncio.run(call())


def get_network_path(path):
    """Return the path of a route on the network."""
    return NETWORK_PREFIX + path
