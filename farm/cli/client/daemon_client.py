"""Client of the daemon: requests and responses of `farm.api`, over its Unix socket or the network."""

from __future__ import annotations

import json
import os
import time
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import closing, suppress
from http.client import HTTPException
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO, TypeVar
from urllib.parse import quote, urlencode

from pydantic import BaseModel, ValidationError

from farm import api
from farm.cli.client.connections import Address, make_headers, make_target, open_connection, read_address
from farm.errors import DaemonUnreachable, ErrorCode, FarmError
from farm.model import JobOptions
from farm.paths import FarmPaths
from farm.text import describe_first_error

View = TypeVar("View", bound=BaseModel)
CONNECT_TIMEOUT_S, RESPONSE_TIMEOUT_S = 5.0, 60.0
SUBMISSION_TIMEOUT_S = 86400.0
"""Seconds to wait for the response to a submission, because the repair of a large model may take hours.

The client polls the progress while it waits."""
_POLL_INTERVAL_S = 0.5
_MAX_NAME_LENGTH = 200
_MIN_ERROR_STATUS = 400  # lowest status code of an error
_CHUNK_BYTES = 1 << 20  # size of a chunk of a download


class Client:
    """Client of one daemon.

    Every method may raise DaemonUnreachable, or the error that the daemon returned, as FarmError.

    Parameters
    ----------
    address
        The daemon's Unix socket, or its address on the network with a key.
    response_timeout_s, connect_timeout_s
        Seconds to wait for a response, and for a connection.
    """

    def __init__(
        self,
        address: Address,
        response_timeout_s: float = RESPONSE_TIMEOUT_S,
        connect_timeout_s: float = CONNECT_TIMEOUT_S,
    ) -> None:
        self._address, self._response_timeout_s, self._connect_timeout_s = (
            address,
            response_timeout_s,
            connect_timeout_s,
        )

    def fetch_status(self) -> api.Status:
        return self._request(api.Status, "GET", "/status")

    def fetch_status_summary(self) -> api.StatusSummary:
        """Fetch the status without the parts and plates of jobs, which is faster for large queues."""
        try:
            return self._request(api.StatusSummary, "GET", "/status/summary")
        except FarmError as error:
            if error.code is not ErrorCode.NO_SUCH_THING:
                raise
            raise _make_version_error(error) from error  # a daemon of an earlier version has no such route

    def fetch_names(self) -> api.Names:
        return self._request(api.Names, "GET", "/names")

    def fetch_job(self, number: int) -> api.JobStatus:
        return self._request(api.JobStatus, "GET", f"/jobs/{number}")

    def cancel_job(self, number: int) -> api.JobStatus:
        return self._request(api.JobStatus, "POST", f"/jobs/{number}/cancel")

    def clear_bed(self, printer: str, request: api.ClearedRequest) -> api.ClearedResponse:
        return self._request(api.ClearedResponse, "POST", f"/printers/{printer}/cleared", body=request)

    def fetch_history(self, job: int | None, printer: str | None, last: int) -> api.History:
        filters = {"job": job, "printer": printer, "last": last}
        params = {name: value for name, value in filters.items() if value is not None}
        return self._request(api.History, "GET", "/history", params=params)

    def send_command(self, path: str, why: str | None = None) -> str:
        """Send a command; return the name of the affected part or printers, if the daemon returns one."""
        body = None if why is None else api.Reason(why=why)
        response = self._send("POST", path, body=body)
        return _validate_response(api.NameResponse, response).name if response else ""

    def load_reel(self, printer: str, request: api.LoadRequest) -> api.Reel:
        return self._request(api.Reel, "POST", f"/printers/{printer}/load", body=request)

    def approve_job(self, number: int, request: api.ApproveRequest) -> None:
        self._send("POST", f"/jobs/{number}/approve", body=request)

    def record_assembly(self, number: int, request: api.AssembledRequest) -> api.JobStatus:
        return self._request(api.JobStatus, "POST", f"/jobs/{number}/assembled", body=request)

    def fetch_hosts(self) -> api.HostList:
        return self._request(api.HostList, "GET", "/hosts")

    def update_hosts(self) -> api.HostUpdate:
        return self._request(api.HostUpdate, "POST", "/hosts/update")

    def fetch_queue(self) -> api.Queue:
        return self._request(api.Queue, "GET", "/queue")

    def move_job(self, number: int, request: api.QueueMove) -> api.Queue:
        return self._request(api.Queue, "POST", f"/jobs/{number}/move", body=request)

    def reschedule_job(self, number: int, request: api.JobStart) -> api.JobStatus:
        return self._request(api.JobStatus, "POST", f"/jobs/{number}/start", body=request)

    def fetch_timeline(self, number: int) -> api.Timeline:
        return self._request(api.Timeline, "GET", f"/jobs/{number}/timeline")

    def list_files(self, number: int) -> api.JobFiles:
        return self._request(api.JobFiles, "GET", f"/jobs/{number}/files")

    def download_file(self, number: int, name: str, write: Callable[[bytes], None]) -> None:
        """Download a file of a job, and call `write` with each chunk."""
        self._send("GET", f"/jobs/{number}/files/{name}", write=write)

    def prune(self, dry_run: bool) -> api.PruneResponse:
        """Delete expired files, or only list them in a dry run.

        This may take a long time: the daemon draws the parts of a job before it deletes the job's files.
        """
        body = api.PruneRequest(dry_run=dry_run)
        return _validate_response(
            api.PruneResponse,
            self._send("POST", "/prune", body=body, response_timeout_s=SUBMISSION_TIMEOUT_S),
        )

    def fetch_keys(self) -> api.Keys:
        return self._request(api.Keys, "GET", "/keys")

    def add_key(self, request: api.KeyRequest) -> api.NewKey:
        return self._request(api.NewKey, "POST", "/keys", body=request)

    def revoke_key(self, key_id: str) -> None:
        self._send("POST", f"/keys/{key_id}/revoke")

    def grant_key(self, code: str, grant: api.AppKeyGrant) -> api.NameResponse:
        return self._request(api.NameResponse, "POST", f"/keys/requests/{code}/grant", body=grant)

    def deny_key(self, code: str) -> None:
        self._send("POST", f"/keys/requests/{code}/deny")

    def make_login_link(self) -> api.LoginLink:
        return self._request(api.LoginLink, "POST", "/sessions/link")

    def end_sessions(self) -> api.EndedSessions:
        return self._request(api.EndedSessions, "POST", "/sessions/end")

    def shut_down(self, now: bool, wait: bool) -> None:
        self._send("POST", "/down", body=api.DownRequest(now=now, wait=wait))

    def submit(
        self,
        model: Path,
        options: JobOptions,
        retry_s: float = 60.0,
        report: Callable[[api.UploadView], None] = lambda _: None,
    ) -> api.SubmitResponse:
        """Upload a model; retry for `retry_s` with the same request id while the daemon is unreachable.

        Parameters
        ----------
        model, options
            The model's file, and its print options.
        retry_s
            Seconds for which to retry.
        report
            Function that is called with the progress of the upload every half second.
        """
        params = {
            "request_id": uuid.uuid4().hex,
            "name": os.fsencode(model.name).decode(errors="replace")[:_MAX_NAME_LENGTH],
            "size": str(model.stat().st_size),
            "options": options.model_dump_json(exclude_none=True),
        }
        self.fetch_status()  # raises at once if there is no daemon
        deadline_s = time.monotonic() + retry_s
        while True:
            try:
                return self._upload_model(model, params, report)
            except DaemonUnreachable:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.5)

    def _upload_model(
        self, model: Path, params: Mapping[str, str], report: Callable[[api.UploadView], None]
    ) -> api.SubmitResponse:
        """Upload a model once, and wait for the response while the daemon reports progress."""
        result: Future[Any] = Future()

        def send() -> None:
            try:
                with model.open("rb") as file:
                    response = self._send(
                        "POST", "/jobs", params=params, upload=file, response_timeout_s=SUBMISSION_TIMEOUT_S
                    )
                result.set_result(response)
            except BaseException as error:
                result.set_exception(error)

        Thread(target=send, daemon=True).start()  # Ctrl-C does not wait for a daemon thread
        last_response_s = time.monotonic()
        while True:
            with suppress(TimeoutError):
                return _validate_response(api.SubmitResponse, result.result(_POLL_INTERVAL_S))
            try:
                report(self._request(api.UploadView, "GET", f"/uploads/{params['request_id']}"))
            except DaemonUnreachable:
                if time.monotonic() - last_response_s > self._response_timeout_s and not result.done():
                    raise
            except FarmError:  # the upload has not started or has ended, or the daemon has an earlier version
                last_response_s = time.monotonic()
            else:
                last_response_s = time.monotonic()

    def _request(
        self,
        view: type[View],
        method: str,
        path: str,
        *,
        params: Mapping[str, str | int] | None = None,
        body: BaseModel | None = None,
    ) -> View:
        return _validate_response(view, self._send(method, path, params=params, body=body))

    def _send(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, str | int] | None = None,
        body: BaseModel | None = None,
        upload: BinaryIO | None = None,
        response_timeout_s: float | None = None,
        write: Callable[[bytes], None] | None = None,
    ) -> Any:
        target = make_target(self._address, quote(path)) + (f"?{urlencode(params)}" if params else "")
        content = upload if body is None else body.model_dump_json().encode()
        headers = make_headers(self._address)
        if body is not None:
            headers["Content-Type"] = "application/json"
        response_timeout_s = response_timeout_s or self._response_timeout_s
        try:
            with closing(
                open_connection(self._address, self._connect_timeout_s, response_timeout_s)
            ) as connection:
                # The daemon may respond before it has read the whole request.
                with suppress(BrokenPipeError, ConnectionResetError):
                    connection.request(method, target, content, headers)
                response = connection.getresponse()
                if write is not None and response.status < _MIN_ERROR_STATUS:
                    while chunk := response.read(_CHUNK_BYTES):
                        write(chunk)
                    return None
                text = response.read()
        except TimeoutError as error:
            raise DaemonUnreachable(
                f"the daemon has not answered for {response_timeout_s:g} s and may hang; the command may "
                "still take effect: check `farm status`; `farm estop` works without the daemon"
            ) from error
        except PermissionError as error:
            raise DaemonUnreachable(
                f"you may not use {self._address}: only the farm's owner and the members of its group may"
            ) from error
        except (OSError, HTTPException) as error:
            cause = (error.strerror if isinstance(error, OSError) else None) or error
            raise DaemonUnreachable(
                f"no daemon answers at {self._address} ({cause}); {_make_advice(self._address)}"
            ) from error
        return _read_response(response.status, text)


def _read_response(status: int, text: bytes) -> Any:
    """Parse the JSON of a response. Raises FarmError with the daemon's message if the status is an error."""
    try:
        values = json.loads(text)
        if status < _MIN_ERROR_STATUS:
            return values
        problem = api.Problem.model_validate(values)
        code = ErrorCode(problem.code)
    except ValueError:
        start = text.decode(errors="replace")[:200]
        raise FarmError(f"the daemon answered {status}: {start}") from None
    raise FarmError(problem.error, code)


def connect(paths: FarmPaths) -> Client:
    """Return a client of the daemon: over the network if `paths` has a URL, else over the Unix socket.

    Raises
    ------
    FarmError
        If the URL or the key's file cannot be used.
    """
    return Client(paths.socket if paths.url is None else read_address(paths.url, paths.key_file))


def _make_advice(address: Address) -> str:
    return (
        "`farm up` starts one"
        if isinstance(address, Path)
        else "check that it is running there, with `web` in its fleet.yaml, and that no firewall blocks it"
    )


def _make_version_error(problem: object) -> FarmError:
    return FarmError(
        f"the daemon has a different version from this command ({problem}): end it with SIGTERM, which does "
        "not end prints, and start it again with `farm up`"
    )


def _validate_response(view: type[View], response: object) -> View:
    """Validate a response. Raises FarmError if the daemon has another version."""
    try:
        return view.model_validate(response)
    except ValidationError as error:
        raise _make_version_error(describe_first_error(error.errors())) from error
