"""A farm whose first printer is idle, and callers of every kind on the network."""

import asyncio

import httpx

from books.recording_controller import RecordedEffects
from clusters.same_process import AcceptingWorkers
from farm.api import KeyRequest
from farm.config import Fleet
from farm.control import Controller, DryRuns, KeyCommands
from farm.http import Services, make_app
from farm.model import AgentSnapshot, FilamentState, Link, Role
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.state.storage.store import Store
from farm.web import make_web_app
from farm.web.cookies import SessionCookie
from hosts.manual_clock import ManualClock

PRINTER_MODEL = "ultimaker2_plus"
HOST = "farm.lab.example"
SAME_ORIGIN_HEADERS = {"origin": f"http://{HOST}"}


class NetworkFarm:
    """Controller and network application, with methods that create keys and sessions of callers."""

    def __init__(self, folder, web=None, fleet=None, printers=("a",)):
        self.state = StateFolder(folder / "state")
        self.state.make()
        self.store = Store(self.state.books)
        self.clock = ManualClock(1.7e9)
        rows = [{"name": name, "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"} for name in printers]
        sections = {"fleet": fleet or {}, "web": web or {}, "printers": rows}
        self.controller = Controller(Fleet.model_validate(sections), self.store, self.clock, list_bed_boxes)
        self.controller.start(RecordedEffects())
        ready = {"link": Link.READY, "bed_clear": True, "filament": FilamentState.PARKED}
        self.controller.on_snapshot(AgentSnapshot(printer=printers[0], **ready))
        self.shutdowns = []
        self.user_roles = {}
        self.services = Services(
            self.controller,
            self.state,
            folder / "fleet.yaml",
            AcceptingWorkers(),
            self._record_shutdown,
            find_user_role=lambda name, _: self.user_roles.get(name, Role.OPERATE),
        )
        self.keys, self.sessions = KeyCommands(self.controller), self.services.sessions
        self.unix = make_app(self.services, DryRuns(self.controller))
        self.dry_runs = DryRuns(self.controller)
        self.web = make_web_app(self.services, self.dry_runs, {HOST})
        self.cookie = SessionCookie.for_section(self.controller.fleet.web)

    async def _record_shutdown(self, now):
        self.shutdowns.append(now)

    def ask(self, method, path, key_text=None, host=HOST, address="10.0.0.9", headers=None, **options):
        """Send a request, with a key if its text is given."""
        own_headers = {"x-api-key": key_text} if key_text else {}

        async def call():
            transport = httpx.ASGITransport(self.web, client=(address, 1), raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url=f"http://{host}") as client:
                return await client.request(
                    method, path, headers={**own_headers, **(headers or {})}, **options
                )

        return asyncio.run(call())

    def browse(self, method, path, session=None, headers=None, **options):
        """Send a request as a browser does from the farm's own pages, in a session if its text is given."""
        own_headers = {
            "accept": "text/html",
            **SAME_ORIGIN_HEADERS,
            **(self.make_cookie_header(session) if session else {}),
        }
        return self.ask(method, path, headers={**own_headers, **(headers or {})}, **options)

    def make_cookie_header(self, session):
        """Return the header with the cookie of a session."""
        return {"cookie": f"{self.cookie.name}={session}"}

    def add_key(self, role, name=None, days=None):
        """Add a key with a role, which expires after some days if their number is given."""
        return self.keys.add(KeyRequest(name=name or str(role), role=role, days=days), "ann")

    def open_session(self, role=Role.OPERATE, user="ann"):
        """Open a session, and return its text."""
        return self.sessions.open(self.sessions.make_link(user, role))

    def log_in(self, key, address="10.0.0.9"):
        """Send the form of the log-in page with the text of a key."""
        return self.browse("POST", "/login", data={"key": key}, address=address)

    def read_last_event(self):
        """Return the kind and the body of the last event."""
        return self.store.read_all_events()[-1][1:]
