"""Route of the printers' cameras."""

from __future__ import annotations

from fastapi import APIRouter, Response

from farm import api
from farm.http.services import Services

_IMAGES = {media_type: {"schema": {"type": "string"}} for media_type in ("image/jpeg", "image/png")}


def make_camera_routes(services: Services) -> APIRouter:
    """Return the route of the printers' cameras."""
    router = APIRouter()

    @router.get(
        "/printers/{name}/camera",
        response_class=Response,
        responses={
            200: {"description": "A still, two seconds old at most.", "content": _IMAGES},
            503: {"description": "The camera sends no still.", "model": api.Problem},
        },
    )
    async def send_still(name: str) -> Response:
        image = await services.fetch_still(name)
        return Response(image.content, media_type=image.media_type, headers={"cache-control": "no-store"})

    return router
