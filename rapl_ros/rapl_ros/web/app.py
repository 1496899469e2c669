"""The HTTP interface: routes and nothing else."""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from http import HTTPStatus
from importlib import resources
from typing import Annotated, Any

from fastapi import FastAPI, Path, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.exceptions import HTTPException

from rapl_core.errors import RaplError
from rapl_ros.web.desk import QueryDesk
from rapl_ros.web.guard import Guard, HostRule
from rapl_ros.web.live import LiveBoard, LiveView
from rapl_ros.web.ports import PreferencePort, SystemPort
from rapl_ros.web.problems import Problem, RefusedError, bad_request
from rapl_ros.web.schemas import (
    AlignRequest,
    AnnotatorName,
    Done,
    EncoderRequest,
    Progress,
    QueryRequest,
    RankingRequest,
    ShownQuery,
    Stored,
    Undone,
    UndoRequest,
)
from rapl_ros.web.sprites import SheetCache

STATIC = resources.files("rapl_ros.web") / "static"
FOREVER = "private, max-age=31536000, immutable"
VideoKey = Annotated[str, Path(pattern=r"^[0-9a-f]{32}$")]

_TEXTS = {
    401: "The token is missing or wrong.",
    403: "Another origin, or a name that is not this server's.",
    404: "There is no such thing.",
    405: "Another method.",
    408: "The body came too slowly.",
    409: "Right once, or somebody was first: the code tells.",
    413: "The body is too large.",
    415: "The body is not JSON.",
    422: "The request is wrong; the message tells where.",
    503: "Another node does not answer or has nothing to give; the message tells.",
}


def _refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    always = (401, 403, 405, 503)
    return {s: {"model": Problem, "description": _TEXTS[s]} for s in (*always, *statuses)}


_POST = (408, 409, 413, 415, 422)


class WebApp:
    """The routes and what they need.

    :param question: what people are asked.
    :param on_refusal: told code and message of each refusal; called on the server's thread.
    """

    def __init__(
        self,
        preference: PreferencePort,
        system: SystemPort,
        sheets: SheetCache,
        board: LiveBoard,
        question: str,
        on_refusal: Callable[[str, str], None],
    ) -> None:
        self._preference, self._system = preference, system
        self._sheets, self._board = sheets, board
        self._desk = QueryDesk(preference, sheets)
        self._question, self._on_refusal = question, on_refusal
        self._tasks: set[asyncio.Task[None]] = set()
        self.api = self._build()

    def guarded(self, hosts: HostRule, token: str, operator_token: str) -> Guard:
        """Return the application behind its guard."""
        return Guard(self.api, hosts, token, operator_token, self._on_refusal)

    def _build(self) -> FastAPI:
        api = FastAPI(
            title="RAPL: people rank videos",
            version="1",
            docs_url=None,
            redoc_url=None,
            openapi_url="/api/openapi.json",
        )
        api.add_exception_handler(RefusedError, self._on_refused)
        api.add_exception_handler(RequestValidationError, self._on_invalid)
        api.add_exception_handler(HTTPException, self._on_http_error)
        api.add_exception_handler(Exception, self._on_fault)
        self._add_ranking_routes(api)
        self._add_live_routes(api)
        for address, name in (("/", "rank.html"), ("/live", "live.html")):
            api.add_api_route(address, _page(name), include_in_schema=False)
        api.mount("/static", StaticFiles(directory=str(STATIC)))
        return api

    def _add_ranking_routes(self, api: FastAPI) -> None:
        @api.post("/api/queries", responses=_refusals(*_POST))
        async def next_query(body: QueryRequest) -> ShownQuery:
            """Lease a query to rank; a page that was reloaded gets back what it had."""
            shown = await self._desk.next(body)
            self._warm(shown)
            return shown

        @api.post("/api/rankings", responses=_refusals(*_POST))
        async def submit_ranking(body: RankingRequest) -> Stored:
            """Store an answer; it is on disk when this returns."""
            return Stored(standing=await self._desk.submit(body))

        @api.post("/api/undo", responses=_refusals(*_POST))
        async def undo(body: UndoRequest) -> Undone:
            """Take back the annotator's newest answer and hand its query out again."""
            undone = await self._desk.undo(body)
            self._warm(undone.query)
            return undone

        @api.get("/api/progress", responses=_refusals(422))
        async def progress(annotator: AnnotatorName | None = None) -> Progress:
            """How far the rankings are, and who gave them; of one annotator, only the own row."""
            found = await self._preference.progress()
            here = {"question": self._question, "stage": self._board.stage}
            return _of_one(found, annotator).model_copy(update=here)

        @api.get(
            "/api/videos/{key}.webp",
            response_class=Response,
            responses=_refusals(404, 422) | {200: {"content": {"image/webp": {}}}},
        )
        async def video(key: VideoKey) -> Response:
            """The sheet of a video's frames."""
            try:
                episode_id = self._desk.episode_of(key)
            except KeyError:
                text = "there is no such video, or it was handed out too long ago"
                raise RefusedError(HTTPStatus.NOT_FOUND, "no_video", text) from None
            try:
                sheet = await asyncio.to_thread(self._sheets.sheet, episode_id)
            except (RaplError, OSError) as error:
                raise self._desk.report_unreadable(episode_id, error) from error
            return Response(sheet, media_type="image/webp", headers={"Cache-Control": FOREVER})

    def _add_live_routes(self, api: FastAPI) -> None:
        @api.get("/api/live", responses=_refusals())
        async def live() -> LiveView:
            """The newest of everything."""
            return await asyncio.to_thread(self._board.view)

        @api.get(
            "/api/camera.jpg",
            response_class=Response,
            responses=_refusals(404) | {200: {"content": {"image/jpeg": {}}}},
        )
        async def camera() -> Response:
            """The camera's newest picture; asking keeps the camera subscribed for some seconds."""
            picture = await self._system.picture()
            if picture is None:
                raise RefusedError(HTTPStatus.NOT_FOUND, "no_picture", "no picture has come yet")
            return Response(picture, media_type="image/jpeg")

        @api.post("/api/align", status_code=HTTPStatus.ACCEPTED, responses=_refusals(*_POST))
        async def align(body: AlignRequest) -> Done:
            """Begin to train an encoder from the rankings there are."""
            return Done(message=await self._system.align())

        @api.post("/api/encoder", status_code=HTTPStatus.ACCEPTED, responses=_refusals(*_POST))
        async def swap(body: EncoderRequest) -> Done:
            """Begin to put another encoder to work."""
            return Done(message=await self._system.swap(body.encoder))

    def _warm(self, shown: ShownQuery) -> None:
        """Make the sheets of a query before the page asks for them."""
        for video in shown.videos:
            key = video.url.removeprefix("/api/videos/").removesuffix(".webp")
            task = asyncio.create_task(self._make(self._desk.episode_of(key)))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _make(self, episode_id: str) -> None:
        with suppress(RaplError, OSError):  # told when the page asks for it
            await asyncio.to_thread(self._sheets.sheet, episode_id)

    # Errors, all in one form

    async def _on_refused(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, RefusedError)
        if error.status is not HTTPStatus.NOT_FOUND or error.code != "no_picture":
            self._tell(request, error)
        return error.response()

    async def _on_invalid(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"][1:]) or "body"
        refused = bad_request("bad_request", f"{place}: {first['msg']}")
        self._tell(request, refused)
        return refused.response()

    async def _on_http_error(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        status = HTTPStatus(error.status_code)
        if status is HTTPStatus.BAD_REQUEST:  # a body that is no text at all: as any wrong one
            status = HTTPStatus.UNPROCESSABLE_ENTITY
            code = "bad_request"
        else:
            code = status.phrase.lower().replace(" ", "_")
        refused = RefusedError(status, code, str(error.detail))
        self._tell(request, refused)
        response = refused.response()
        response.headers.update(error.headers or {})
        return response

    async def _on_fault(self, request: Request, error: Exception) -> JSONResponse:
        logging.getLogger("rapl_ros.web").error("fault in %s", request.url.path, exc_info=error)
        status = HTTPStatus.INTERNAL_SERVER_ERROR
        return RefusedError(status, "fault", "a fault of the server; its log tells").response()

    def _tell(self, request: Request, error: RefusedError) -> None:
        self._on_refusal(error.code, f"{request.method} {request.url.path!r}: {error}")


def _of_one(progress: Progress, annotator: str | None) -> Progress:
    """Leave out all rows but those of one name, however it is capitalised; the exact one first."""
    if annotator is None:
        return progress
    name = annotator.casefold()
    own = [row for row in progress.annotators if row.annotator.casefold() == name]
    own.sort(key=lambda row: row.annotator != annotator)
    return progress.model_copy(update={"annotators": own})


def _page(name: str) -> Callable[[], Any]:
    async def page() -> FileResponse:
        return FileResponse(str(STATIC / name), headers={"Cache-Control": "no-cache"})

    return page
