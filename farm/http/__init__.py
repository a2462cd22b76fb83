"""HTTP interface of the daemon: application, server, and identification of callers."""

from __future__ import annotations

from farm.http.app import UPLOAD_PATH, add_routes, make_app, make_problem_response
from farm.http.body_limit import BodyLimit
from farm.http.callers import (
    CallerName,
    OperatorName,
    PeerProtocol,
    Person,
    check_operator_group,
    identify_caller,
    is_operator,
    listen,
)
from farm.http.connections import (
    BoundedServer,
    WaitingConnection,
    compute_connection_limit,
    find_longest_waiting_connection,
    read_descriptor_limit,
    stop_on_signals,
)
from farm.http.event_streams import EventStreams
from farm.http.routes.files import find_stored_file, map_stored_files
from farm.http.routes.status import describe_farm
from farm.http.services import NetworkState, Services
from farm.http.stream_limit import StreamLimit, StreamResponse
from farm.http.uploads import Upload, Uploads, clean_name

__all__ = [
    "UPLOAD_PATH",
    "BodyLimit",
    "BoundedServer",
    "CallerName",
    "EventStreams",
    "NetworkState",
    "OperatorName",
    "PeerProtocol",
    "Person",
    "Services",
    "StreamLimit",
    "StreamResponse",
    "Upload",
    "Uploads",
    "WaitingConnection",
    "add_routes",
    "check_operator_group",
    "clean_name",
    "compute_connection_limit",
    "describe_farm",
    "find_longest_waiting_connection",
    "find_stored_file",
    "identify_caller",
    "is_operator",
    "listen",
    "make_app",
    "make_problem_response",
    "map_stored_files",
    "read_descriptor_limit",
    "stop_on_signals",
]
