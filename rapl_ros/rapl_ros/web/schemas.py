"""What goes over HTTP: the bodies of requests and answers."""

import unicodedata
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

NAME_BYTES = 64
"""Of an annotator's name in UTF-8: what a message holds."""
MOST_VIDEOS = 10

_PUNCTUATION = frozenset(" .'’@+-_")


def check_name(name: str) -> str:
    """Return an annotator's name if it is one.

    :raises ValueError: if it has other characters than letters, digits, spaces and ``.'@+-_``,
        does not begin and end visibly, or is longer than a message holds.
    """
    if not all(unicodedata.category(c)[0] in "LMN" or c in _PUNCTUATION for c in name):
        raise ValueError("a name has letters, digits, spaces and . ' @ + - _ and nothing else")
    if unicodedata.category(name[0])[0] not in "LN" or name[-1] == " ":
        raise ValueError("a name begins with a letter or digit and does not end with a space")
    if len(name.encode()) > NAME_BYTES:
        raise ValueError(f"a name has at most {NAME_BYTES} bytes in UTF-8")
    return unicodedata.normalize("NFC", name)


AnnotatorName = Annotated[
    str, Field(min_length=1, max_length=NAME_BYTES), AfterValidator(check_name)
]
Identifier = Annotated[str, Field(pattern=r"^[0-9a-zA-Z_-]{8,64}$")]
EncoderName = Annotated[str, Field(pattern=r"^[0-9a-zA-Z_-]{1,64}$")]
PageId = Annotated[str, Field(pattern=r"^[0-9a-zA-Z_-]{0,64}$")]
"""Tells two tabs, or two people of one name, apart; empty: does not matter."""
Seconds = Annotated[float, Field(ge=0, le=86400, allow_inf_nan=False)]


class _Body(BaseModel):
    """Of a request: what is not known is refused, and nothing is converted."""

    model_config = ConfigDict(extra="forbid", strict=True)


class QueryRequest(_Body):
    """Asks for what to rank next."""

    annotator: AnnotatorName
    page: PageId = ""
    held: list[Identifier] = Field(default=[], max_length=8)
    """Queries that the page has already."""


class RankingRequest(_Body):
    """An answer to a query."""

    ranking_id: Identifier
    """Made by the page, so that sending twice stores once."""
    query_id: Identifier
    annotator: AnnotatorName
    verdict: Literal["ranked", "undecided", "skipped"]
    ranks: list[Annotated[int, Field(ge=1, le=MOST_VIDEOS)]] = Field(
        default=[], max_length=MOST_VIDEOS
    )
    """Of the videos as shown, left to right; 1 = best, equal numbers tie; empty unless ranked."""
    response_s: Seconds
    replaces: Annotated[str, Field(pattern=r"^([0-9a-zA-Z_-]{8,64})?$")] = ""
    """The own answer to the same query that this one corrects."""


class UndoRequest(_Body):
    """Takes back an answer."""

    annotator: AnnotatorName
    page: PageId = ""
    ranking_id: Annotated[str, Field(pattern=r"^([0-9a-zA-Z_-]{8,64})?$")] = ""
    """Which; empty: the annotator's newest, unless another page of the same name is at work."""
    withdrawal_id: Identifier
    """Made by the page, so that sending twice takes back once."""


class AlignRequest(_Body):
    """Trains an encoder from the rankings there are."""


class EncoderRequest(_Body):
    """Puts another encoder to work."""

    encoder: EncoderName


class Video(BaseModel):
    """One video of a query: a sheet with all its frames, row by row."""

    url: str
    frames: int
    columns: int
    width: int
    height: int
    period_s: float


class ShownQuery(BaseModel):
    """Videos to rank, in the order in which to show them; no id or label tells what they are."""

    query_id: str
    videos: list[Video]
    expires_in_s: float


class Standing(BaseModel):
    """How far the rankings are."""

    given: int
    """That count, of all annotators."""
    wanted: int
    """0: no number was set."""
    needed: int


class Stored(BaseModel):
    """A ranking is on disk."""

    standing: Standing


class Undone(BaseModel):
    """What was taken back, to be answered anew."""

    query: ShownQuery
    verdict: Literal["ranked", "undecided", "skipped"]
    ranks: list[int]
    standing: Standing


class AnnotatorStanding(BaseModel):
    """How one annotator gets on; null where nothing is known."""

    annotator: str
    ranked: int
    undecided: int
    skipped: int
    consistency: float | None
    consistency_pairs: int
    agreement: float | None
    agreement_pairs: int
    median_response_s: float | None


class Progress(BaseModel):
    """How far the rankings are, and who gave them."""

    standing: Standing
    question: str = ""
    """What people are asked."""
    stage: str = ""
    """Of the run, such as `train`; `over` after the last, empty if unknown."""
    videos: int
    agreement: float | None
    agreement_pairs: int
    strategy: str
    annotators: list[AnnotatorStanding]


class Done(BaseModel):
    """Something was begun or done."""

    message: str
