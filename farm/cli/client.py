"""The CLI's way to the daemon: `farm.api` over the daemon's Unix socket."""

from __future__ import annotations

import os
import time
import uuid
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from farm import api
from farm.errors import DaemonUnreachable, ErrorCode, FarmError
from farm.model import JobOptions

_PATIENCE_S = 600.0  # a large broken model is repaired before its submission is answered
_CHUNK = 1 << 20
_LONGEST_NAME = 200


class Client:
    """One daemon. Methods raise DaemonUnreachable, or the FarmError that the daemon answered."""

    def __init__(self, socket: Path) -> None:
        import httpx  # slow to load, and an emergency stop does without it

        self._socket = socket
        self._lost: type[Exception] = httpx.TransportError
        self._late: type[Exception] = httpx.ReadTimeout
        self._http = httpx.Client(
            transport=httpx.HTTPTransport(uds=str(socket)),
            base_url="http://farm",
            timeout=httpx.Timeout(_PATIENCE_S, connect=5.0),
        )

    def status(self) -> api.Status:
        return api.Status.model_validate(self._call("GET", "/status"))

    def job(self, number: int) -> api.JobStatus:
        return api.JobStatus.model_validate(self._call("GET", f"/jobs/{number}"))

    def cancel(self, number: int) -> api.JobStatus:
        return api.JobStatus.model_validate(self._call("POST", f"/jobs/{number}/cancel"))

    def cleared(self, printer: str, request: api.ClearedRequest) -> api.Cleared:
        answer = self._call("POST", f"/printers/{printer}/cleared", body=request)
        return api.Cleared.model_validate(answer)

    def history(self, job: int | None, printer: str | None, last: int) -> api.History:
        asked = {"job": job, "printer": printer, "last": last}
        params = {name: value for name, value in asked.items() if value is not None}
        return api.History.model_validate(self._call("GET", "/history", params=params))

    def tell(self, path: str, why: str | None = None) -> str:
        """Ask something of a job, a part or a printer; the name of what was meant."""
        body = None if why is None else api.Reason(why=why)
        answer = self._call("POST", path, body=body)
        return api.Named.model_validate(answer).name if answer else ""

    def load(self, printer: str, request: api.LoadRequest) -> api.Reel:
        return api.Reel.model_validate(self._call("POST", f"/printers/{printer}/load", body=request))

    def approve(self, number: int, request: api.ApproveRequest) -> None:
        self._call("POST", f"/jobs/{number}/approve", body=request)

    def night(self, number: int) -> api.Night:
        return api.Night.model_validate(self._call("GET", f"/jobs/{number}/night"))

    def down(self, now: bool, wait: bool) -> None:
        self._call("POST", "/down", body=api.DownRequest(now=now, wait=wait))

    def submit(self, model: Path, options: JobOptions, patience_s: float = 60.0) -> api.Submitted:
        """Upload a model. Tried again with the same request id while the daemon is away, for `patience_s`."""
        params = {
            "request_id": uuid.uuid4().hex,
            "name": os.fsencode(model.name).decode(errors="replace")[:_LONGEST_NAME],
            "size": str(model.stat().st_size),
            "options": options.model_dump_json(exclude_none=True),
        }
        self.status()  # where no daemon is there at all, say so at once
        give_up = time.monotonic() + patience_s
        while True:
            try:
                with model.open("rb") as file:
                    chunks = iter(lambda: file.read(_CHUNK), b"")
                    answer = self._call("POST", "/jobs", params=params, content=chunks)
                return api.Submitted.model_validate(answer)
            except DaemonUnreachable:
                if time.monotonic() > give_up:
                    raise
                time.sleep(0.5)

    def _call(self, method: str, path: str, *, body: BaseModel | None = None, **more: Any) -> Any:
        try:
            json = None if body is None else body.model_dump(mode="json")
            if json is not None:
                more["json"] = json
            answer = self._http.request(method, path, **more)
        except self._late as error:
            raise DaemonUnreachable(
                f"the daemon has not answered for {_PATIENCE_S / 60:.0f} minutes; what was asked may still "
                "be done: look at `farm status`"
            ) from error
        except self._lost as error:
            raise DaemonUnreachable(
                f"no daemon answers on {self._socket} ({error}); `farm up` starts one"
            ) from error
        if answer.is_success:
            return answer.json()
        try:
            problem = api.Problem.model_validate(answer.json())
        except ValueError:
            raise FarmError(f"the daemon answered {answer.status_code}: {answer.text[:200]}") from None
        raise FarmError(problem.error, ErrorCode(problem.code))
