"""The pages and files of the site: addresses, errors as pages, and work handed to threads."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Hashable
from importlib.resources import files
from typing import Any, TypeVar

import jinja2
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp

from upvl_cli.errors import BadSetting, NotMade, UpvlError, one_line
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.web.catalog import Catalog
from upvl_cli.web.downloads import EXPORTS, csv_of_hits, export_hits, parquet_of_hits
from upvl_cli.web.guard import Access, Guard
from upvl_cli.web.hit_page import cameras_at, hit_page, track_json
from upvl_cli.web.jobs import Jobs, TooBusy
from upvl_cli.web.parameters import SOURCES, Asked, Question, encode, parse
from upvl_cli.web.pictures import Picture, Pictures
from upvl_cli.web.raw_drives import NoRawData, RawDrives
from upvl_cli.web.results_page import form, results
from upvl_cli.web.scene import boxes_of_frame, packed_points
from upvl_cli.web.search import Search, SearchResult

Result = TypeVar("Result")
STATIC = {
    "style.css": "text/css",
    "page.js": "text/javascript",
    "view3d.js": "text/javascript",
    "icon.svg": "image/svg+xml",
}
_KEPT = {"Cache-Control": "private, max-age=3600"}  # the addresses of pictures change with the shards
_MOST_FRAMES = 2**31
_ANYWAY = " (--anyway asks regardless)"
_PAGE_THREADS, _PICTURE_THREADS = 4, 2


class Site:
    """The application over one workspace."""

    def __init__(self, workspace: Workspace) -> None:
        """Name the workspace; nothing is opened before the first question."""
        self._search = Search(workspace)
        self._drives = RawDrives(workspace)
        self._pictures = Pictures(self._drives)
        self._jobs, self._picture_jobs = Jobs(_PAGE_THREADS), Jobs(_PICTURE_THREADS)
        self._picture_slots = asyncio.Semaphore(_PICTURE_THREADS)
        self._name = workspace.out.resolve().parent.name
        self._templates = jinja2.Environment(
            loader=jinja2.PackageLoader("upvl_cli.web"), autoescape=True, undefined=jinja2.StrictUndefined
        )
        self._static = {name: (files("upvl_cli.web") / "static" / name).read_bytes() for name in STATIC}

    def application(self, access: Access) -> ASGIApp:
        """Return the ASGI application.

        Args:
            access: Who may ask.
        """
        place = "/{source}/{segment}/{frame:int}"
        routes = [
            Route("/", self._home),
            Route(f"/hit{place}/{{box:int}}", self._hit),
            Route(f"/above{place}/{{box:int}}", self._above),
            Route(f"/crop{place}/{{box:int}}", self._crop),
            Route(f"/camera{place}/{{number:int}}", self._camera),
            Route(f"/api/boxes{place}", self._boxes),
            Route(f"/api/points{place}", self._points),
            Route("/api/track/{source}/{segment}/{track:int}", self._track),
            Route("/save/{format}", self._save),
            Route("/static/{name}", self._file),
            Route("/health", self._health),
        ]
        handlers: Any = {HTTPException: _http_error, UpvlError: self._error, Exception: _bug}
        return Guard(Starlette(routes=routes, exception_handlers=handlers), access)

    def close(self) -> None:
        """Leave what waits undone."""
        self._jobs.close()
        self._picture_jobs.close()

    def warm_up(self) -> None:
        """Open the default source, so that the first question is as quick as others."""
        try:
            catalog = self._search.catalogs.get("")
            if not catalog.no_words:
                self._search.ask(Question(words=("car",)))
        except UpvlError:
            return  # the page says what is wrong

    async def _run(self, key: Hashable, function: Callable[[], Result]) -> Result:
        return await self._jobs.run(key, function)

    async def _ask(self, question: Question) -> SearchResult:
        return await self._run(("ask", question), lambda: self._search.ask(question))

    def _page(self, template: str, status: int = 200, **values: Any) -> HTMLResponse:
        text = self._templates.get_template(template).render(workspace=self._name, **values)
        return HTMLResponse(text, status)

    async def _home(self, request: Request) -> Response:
        asked = Asked(Question())
        try:
            asked = parse(request.scope["query_string"])
            if not asked.is_asked:
                return await self._run("form", lambda: self._form_page(asked, "", 200))
            found = await self._ask(asked.question)
            return await self._run(("results", asked), lambda: self._results_page(found, asked))
        except UpvlError as error:
            message, status = one_line(error), _status(error)
            return await self._run(("form", asked, message), lambda: self._form_page(asked, message, status))

    def _form_page(self, asked: Asked, message: str, status: int) -> Response:
        """Return the form without results; where nothing can be searched, why."""
        catalog, problem = None, ""
        try:
            catalog = self._search.catalogs.get(asked.question.source)
        except UpvlError as error:
            problem = one_line(error)
        shown = form(self._search.catalogs, catalog, asked)
        # What the command line calls --anyway is a link here.
        insist = asked.address(anyway=True) if message.endswith(_ANYWAY) else ""
        plain = (message or problem).removesuffix(_ANYWAY)
        return self._page(
            "search.html",
            status,
            form=shown,
            results=None,
            message=plain,
            insist=insist,
            formats=list(EXPORTS),
        )

    def _results_page(self, found: SearchResult, asked: Asked) -> Response:
        shown = form(self._search.catalogs, found.catalog, asked)
        return self._page(
            "search.html",
            form=shown,
            results=results(found, asked),
            message="",
            insist="",
            formats=list(EXPORTS),
        )

    async def _hit(self, request: Request) -> Response:
        asked = parse(request.scope["query_string"])
        source, segment, frame = _place(request)
        box = _number(request, "box")

        def make() -> Response:
            catalog = self._search.catalogs.get(source)
            catalog.row(segment, frame, box)
            answer = self._search.ask(asked.question).answer if asked.question.words else None
            shown = hit_page(catalog, self._drives, (segment, frame, box), asked, answer)
            return self._page("hit.html", hit=shown)

        return await self._run(("hit", source, segment, frame, box, encode(asked)), make)

    async def _picture(self, request: Request, draw: Callable[[Catalog, str, int, int], Picture]) -> Response:
        source, segment, frame = _place(request)
        number = _number(request, "number" if "number" in request.path_params else "box")

        def make() -> Picture:
            return draw(self._search.catalogs.get(source), segment, frame, number)

        # Pages are not to wait for pictures, nor pictures for those whose reader has left.
        async with self._picture_slots:
            if await request.is_disconnected():
                return Response(status_code=204)
            kind, content = await self._picture_jobs.run(
                (draw.__name__, source, segment, frame, number), make
            )
        return Response(content, media_type=kind, headers=_KEPT)

    async def _above(self, request: Request) -> Response:
        return await self._picture(request, self._pictures.above)

    async def _crop(self, request: Request) -> Response:
        return await self._picture(request, self._pictures.crop)

    async def _camera(self, request: Request) -> Response:
        track = _track_of(request)

        def camera(catalog: Catalog, segment: str, frame: int, number: int) -> Picture:
            catalog.row(segment, frame, 0)
            return self._pictures.camera(catalog, segment, frame, number, track)

        return await self._picture(request, camera)

    async def _boxes(self, request: Request) -> Response:
        source, segment, frame = _place(request)
        track = _track_of(request)

        def make() -> dict[str, Any]:
            catalog = self._search.catalogs.get(source)
            shown = boxes_of_frame(catalog, segment, frame)
            rows = [row for row, box in enumerate(shown["boxes"]) if box["track"] == track]
            start = catalog.row(segment, frame, rows[0]) if rows else None
            return shown | {"cameras": cameras_at(catalog, self._drives, segment, frame, start)}

        return _json(await self._run(("boxes", source, segment, frame, track), make))

    async def _points(self, request: Request) -> Response:
        source, segment, frame = _place(request)

        def make() -> bytes:
            self._search.catalogs.get(source).row(segment, frame, 0)
            return packed_points(self._drives.points(segment, frame))

        content = await self._run(("points", source, segment, frame), make)
        return Response(content, media_type="application/octet-stream", headers=_KEPT)

    async def _track(self, request: Request) -> Response:
        source, segment = _source(request), str(request.path_params["segment"])
        track = _number(request, "track")

        def make() -> dict[str, Any]:
            return track_json(self._search.catalogs.get(source), segment, track)

        return _json(await self._run(("track", source, segment, track), make))

    async def _save(self, request: Request) -> Response:
        asked, name = parse(request.scope["query_string"]), str(request.path_params["format"])
        if name not in ("hits.csv", "hits.parquet", *EXPORTS):
            raise HTTPException(404)
        found = await self._ask(asked.question)
        answer = found.answer
        threshold = answer.threshold if asked.threshold is None else asked.threshold
        hits = answer.hits[: answer.above(threshold)]
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        if name == "hits.csv":
            return StreamingResponse(csv_of_hits(hits, answer.vocabulary), 200, headers, "text/csv")
        if name == "hits.parquet":
            content = await self._run(("parquet", asked), lambda: parquet_of_hits(hits, answer.vocabulary))
            return Response(content, 200, headers, "application/vnd.apache.parquet")
        source, workspace = found.catalog.source, self._search.workspace
        packed = await self._run(
            ("export", asked, name), lambda: export_hits(workspace, source, answer, hits, name)
        )
        return Response(packed, 200, headers, "application/zip")

    async def _file(self, request: Request) -> Response:
        name = str(request.path_params["name"])
        if name not in self._static:
            raise HTTPException(404)
        return Response(self._static[name], media_type=STATIC[name], headers={"Cache-Control": "no-cache"})

    async def _health(self, request: Request) -> Response:
        return PlainTextResponse("ok\n")

    async def _error(self, request: Request, error: Exception) -> Response:
        status = _status(error)
        headers = {"Retry-After": "5"} if status == 503 else None
        if not request.url.path.startswith("/hit/"):
            return PlainTextResponse(f"{one_line(error)}\n", status, headers)
        return self._page("message.html", status, message=one_line(error))


def _status(error: BaseException) -> int:
    kinds = ((TooBusy, 503), (NotMade, 404), (NoRawData, 404))
    return next((status for kind, status in kinds if isinstance(error, kind)), 400)


def _source(request: Request) -> str:
    source = str(request.path_params["source"])
    if source not in SOURCES:
        raise HTTPException(404)
    return source


def _place(request: Request) -> tuple[str, str, int]:
    return _source(request), str(request.path_params["segment"]), _number(request, "frame")


def _number(request: Request, name: str) -> int:
    number = int(request.path_params[name])
    if number >= _MOST_FRAMES:
        raise HTTPException(404)
    return number


def _track_of(request: Request) -> int | None:
    text = request.query_params.get("track", "")
    if text and not (text.isascii() and text.isdigit() and len(text) < 19):
        raise BadSetting("track is no whole number")
    return int(text) if text else None


def _json(values: dict[str, Any]) -> Response:
    return Response(json.dumps(values, allow_nan=False), media_type="application/json")


def _http_error(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    message = "there is no such page" if status == 404 else "the request cannot be answered"
    return PlainTextResponse(f"{message}\n", status)


def _bug(request: Request, error: Exception) -> Response:
    """Return no more than that; the traceback goes to the terminal of the server."""
    return PlainTextResponse("an error inside upvl; the terminal of the server shows it\n", 500)
