"""What the server refuses: one form for every error, and a code that the front end acts on."""

from http import HTTPStatus

from pydantic import BaseModel, Field
from starlette.responses import JSONResponse

from rapl_core.errors import RaplError


class Problem(BaseModel):
    """Body of every answer that is an error."""

    code: str = Field(description="For programs, e.g. `unknown_query`.")
    message: str = Field(description="For people.")


class RefusedError(RaplError):
    """A request that is not served.

    :param status: of the HTTP answer.
    :param code: for programs, in snake case.
    :param message: for people: what was wrong and what was expected.
    """

    def __init__(self, status: HTTPStatus, code: str, message: str) -> None:
        self.status, self.code = status, code
        super().__init__(message)

    def response(self) -> JSONResponse:
        """The HTTP answer."""
        body = Problem(code=self.code, message=str(self))
        response = JSONResponse(body.model_dump(), self.status)
        if self.status is HTTPStatus.UNAUTHORIZED:
            response.headers["WWW-Authenticate"] = "Bearer"
        return response


def bad_request(code: str, message: str) -> RefusedError:
    """The request itself is wrong."""
    return RefusedError(HTTPStatus.UNPROCESSABLE_ENTITY, code, message)


def conflict(code: str, message: str) -> RefusedError:
    """The request was right once, or somebody else was first."""
    return RefusedError(HTTPStatus.CONFLICT, code, message)


def unavailable(code: str, message: str) -> RefusedError:
    """Another node does not answer, or has nothing to give yet."""
    return RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, code, message)
