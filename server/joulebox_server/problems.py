"""Every error as RFC 9457 problem+json: the one place that knows HTTP statuses."""

import logging
from collections.abc import Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from joulebox_server.analysis.errors import AnalysisError
from joulebox_server.errors import (
    ConflictError,
    DigestError,
    FieldError,
    ForbiddenError,
    InvalidError,
    NotFoundError,
    PreconditionError,
    ServerError,
    StorageFullError,
    TooLargeError,
    TooManyError,
    UnauthenticatedError,
    UnavailableError,
)
from joulebox_server.store.ids import new_id

log = logging.getLogger("joulebox.server")

# The first that fits an error counts: (status, code, title).
KINDS: dict[type[Exception], tuple[int, str, str]] = {
    DigestError: (422, "wrong_digest", "The bytes are not what their name says"),
    InvalidError: (422, "invalid", "The request cannot be used"),
    AnalysisError: (422, "not_answerable", "The question cannot be answered"),
    UnauthenticatedError: (401, "unauthenticated", "A valid token is needed"),
    ForbiddenError: (403, "forbidden", "The token may not do this"),
    NotFoundError: (404, "not_found", "There is no such thing"),
    ConflictError: (409, "conflict", "The request contradicts what is stored"),
    PreconditionError: (412, "precondition_failed", "It was changed meanwhile"),
    TooManyError: (429, "too_many", "Asked too often"),
    TooLargeError: (413, "too_large", "More than this server accepts"),
    StorageFullError: (507, "storage_full", "The server's disk is full"),
    UnavailableError: (503, "unavailable", "The server cannot do this now"),
    ServerError: (500, "failed", "The server failed"),
}
HTTP_CODES = {
    404: "not_found",
    405: "method_not_allowed",
    408: "too_slow",
    413: "too_large",
    416: "range_not_satisfiable",
}
CLIENT_GONE = 499  # as many servers log a request whose client left
PROBLEM_TYPE = "application/problem+json"
RETRY_AFTER_S = 5
LARGEST_ECHO = 60


def problem(
    request: Request, status: int, code: str, title: str, detail: str, errors: Sequence[FieldError] = ()
) -> JSONResponse:
    """The response that tells an error."""
    request_id = request_id_of(request)
    body = {
        "type": f"urn:joulebox:problem:{code}",
        "title": title,
        "status": status,
        "detail": detail,
        "code": code,
        "request_id": request_id,
        "errors": [{"field": error.field, "message": error.message} for error in errors],
    }
    headers = {"Cache-Control": "no-store", "X-Request-Id": request_id}
    if status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    if status in (503, 507):
        headers["Retry-After"] = str(RETRY_AFTER_S)
    return JSONResponse(body, status, headers, media_type=PROBLEM_TYPE)


def request_id_of(request: Request) -> str:
    """The id that this request has in the log and in its problem."""
    if not hasattr(request.state, "request_id"):
        request.state.request_id = new_id()
    return str(request.state.request_id)


def told(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """These errors, as a route's `responses` state them in the OpenAPI document."""
    content = {PROBLEM_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": HTTPStatus(status).phrase, "content": content} for status in statuses}


def add_problem_handlers(app: FastAPI) -> None:
    """Map every exception that can leave a handler."""

    @app.exception_handler(ServerError)
    async def expected(request: Request, error: Exception) -> JSONResponse:
        status, code, title = next(told for kind, told in KINDS.items() if isinstance(error, kind))
        errors = error.errors if isinstance(error, InvalidError) else ()
        response = problem(request, status, code, title, str(error), errors)
        if isinstance(error, TooManyError):
            response.headers["Retry-After"] = str(error.retry_after_s)
        return response

    @app.exception_handler(RequestValidationError)
    @app.exception_handler(ValidationError)
    async def invalid(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError | ValidationError)
        errors = field_errors(error.errors())
        if any(_is_unread(wrong) for wrong in error.errors()):
            errors = [FieldError("the body", "it must be JSON, with the header Content-Type: application/json")]
        detail = "; ".join(f"{wrong.field}: {wrong.message}" for wrong in errors[:5])
        return problem(request, *KINDS[InvalidError], detail or "the request is empty", errors)

    @app.exception_handler(HTTPException)
    async def refused(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        if error.status_code == 400 and isinstance(error.__cause__, InvalidError):
            return problem(request, *KINDS[InvalidError], f"the body: {error.__cause__}")
        if error.status_code == 400 and isinstance(error.__cause__, RecursionError | ValueError):
            # What FastAPI makes of JSON that Python's reader gives up on.
            return problem(request, *KINDS[InvalidError], f"the body: {_unreadable(error.__cause__)}")
        code = HTTP_CODES.get(error.status_code, "http_error")
        detail = str(error.detail)
        if error.status_code in (404, 405) and detail in ("Not Found", "Method Not Allowed"):
            detail = f"this server has no {request.method} {request.url.path}"
        response = problem(request, error.status_code, code, HTTPStatus(error.status_code).phrase, detail)
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(ClientDisconnect)
    async def gone(request: Request, error: Exception) -> Response:
        log.info("request %s was given up by its client in mid-body", request_id_of(request))
        return Response(status_code=CLIENT_GONE)  # for the log alone: nobody reads it

    @app.exception_handler(Exception)
    async def unexpected(request: Request, error: Exception) -> JSONResponse:
        log.error("request %s failed", request_id_of(request), exc_info=error)
        detail = f"the server failed; its log says more under {request_id_of(request)}"
        return problem(request, *KINDS[ServerError], detail)


def _is_unread(wrong: Any) -> bool:
    """Whether a body was kept as bytes, as FastAPI keeps what is not sent as JSON."""
    return tuple(wrong["loc"]) == ("body",) and isinstance(wrong.get("input"), bytes)


def _unreadable(error: BaseException) -> str:
    if isinstance(error, RecursionError):
        return "its JSON is nested too deeply"
    return "it is not UTF-8" if isinstance(error, UnicodeDecodeError) else "it holds a number of too many digits"


def field_errors(found: Sequence[Any]) -> list[FieldError]:
    """Pydantic's errors with paths as people write them: `axes.gather_count[1]`."""
    return [FieldError(_path(error["loc"]), _message(error)) for error in found]


def _path(location: Sequence[str | int]) -> str:
    if any(isinstance(part, int) for part in location[1:2]) and location[0] == "body":
        return f"character {location[1]} of the body"  # of text that is no JSON at all
    # A part in brackets is the tag of a choice, which nobody wrote.
    inside = [part for part in location if part not in ("body", "query", "path", "header") and str(part)[:1] != "("]
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in inside)
    return text.removeprefix(".") or "the body"


def _message(error: Any) -> str:
    if error["type"] == "extra_forbidden":
        return "this field is not known"
    if error["type"] == "missing":
        return "this field is missing"
    text = str(error["msg"]).removeprefix("Value error, ")
    if text[1:2].islower():  # "Input should ...", not "JSON decode error"
        text = text[0].lower() + text[1:]
    given = error.get("input")
    if isinstance(given, str | int | float | bool) and error["type"] != "value_error":
        text += f", not {str(given)[:LARGEST_ECHO]!r}"
    return text
