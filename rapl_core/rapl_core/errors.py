"""Errors of rapl_core: each names what was wrong, what was expected and what is available."""

from collections.abc import Iterable


class RaplError(Exception):
    """Base of every error that rapl_core raises on purpose."""


class ShapeError(RaplError):
    """An array has another shape, dtype or range than the one documented."""


class UnknownNameError(RaplError):
    """A name that is not registered.

    :param kind: what was looked up, e.g. ``task``.
    :param name: the name that was asked for.
    :param known: the names that exist.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.known = tuple(sorted(known))
        super().__init__(f"unknown {kind} '{name}'; known: {', '.join(self.known) or 'none'}")


class CorruptFileError(RaplError):
    """A stored file (episode, checkpoint, ranking store) cannot be read."""


class WeightsError(RaplError):
    """Backbone or head weights are missing, random, or of another architecture."""


class ConvergenceError(RaplError):
    """A transport solver did not reach its tolerance."""


class RankingError(RaplError):
    """A ranking is not acceptable: unknown or repeated episodes, wrong ranks."""


class RefusedError(RaplError):
    """What is asked for is not done, as it would overwrite something or has nothing to go by."""
