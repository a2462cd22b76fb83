"""Routes with which a program requests its own key, compatible with OctoPrint's plugin `appkeys`.

The routes themselves require no key. A request has no effect until an operator grants it on the farm's host.
"""

from __future__ import annotations

import time
from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field

from farm.http import Services
from farm.web.slicers.paths import APP_KEY_PROBE_PATH, APP_KEY_REQUEST_PATH, APP_KEY_REQUESTS_PATH
from farm.web.slicers.text_errors import TextErrorRoute

_CREATED, _ACCEPTED, _NO_CONTENT = 201, 202, 204


class AppRequest(BaseModel):
    """Request by a program for a key."""

    app: Annotated[str, Field(min_length=1, max_length=200)]


def make_app_key_routes(services: Services) -> APIRouter:
    """Return the routes with which programs request keys."""
    router = APIRouter(route_class=TextErrorRoute, include_in_schema=False)
    requests = services.app_key_requests

    @router.get(APP_KEY_PROBE_PATH, status_code=_NO_CONTENT)
    async def report_support() -> None:
        """Report that programs may request keys."""

    @router.post(APP_KEY_REQUESTS_PATH)
    async def request_key(request: Request, body: AppRequest) -> Response:
        request_url = str(request.url.replace(path=quote(request.url.path), query="", fragment=""))
        token = requests.add(body.app, request.state.caller.address, time.monotonic())
        content = {"app_token": token, "auth_dialog": request_url.removesuffix(APP_KEY_REQUESTS_PATH) + "/"}
        return JSONResponse(content, _CREATED, {"location": f"{request_url}/{token}"})

    @router.get(APP_KEY_REQUEST_PATH)
    async def poll_key(token: str) -> Response:
        key = requests.take_key(token, time.monotonic())
        if key is None:
            return JSONResponse({"message": "Awaiting decision"}, _ACCEPTED)
        return JSONResponse({"api_key": key})

    return router
