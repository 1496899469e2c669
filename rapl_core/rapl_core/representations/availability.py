"""Whether the weights of a backbone are to be had on this machine; nothing is fetched."""

from dataclasses import dataclass
from pathlib import Path

from rapl_core.errors import WeightsError
from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.weights import cached_place, weights_in


@dataclass(frozen=True)
class WeightsPlace:
    """Where the weights of a backbone are, or are to be had."""

    backbone: str
    path: Path | None
    """None: not here."""
    advice: str = ""
    """If not: where they are to be had and how to give them."""


def find_weights(backbone: str, weights: Path | None = None) -> WeightsPlace:
    """Look for the weights of a backbone; the file is not read.

    :param weights: a file, or a folder that may hold it, as for ``load_backbone``.
    :raises UnknownNameError: for an unknown backbone.
    """
    spec = backbone_spec(backbone)
    given = weights_in(weights, backbone) if weights is not None else None
    if given is not None:
        missing = "" if given.is_file() else f"no weights file {given}"
        return WeightsPlace(backbone, None if missing else given, missing)
    if spec.url:
        place = cached_place(spec.url)
        if place.is_file():
            return WeightsPlace(backbone, place)
        return WeightsPlace(backbone, None, f"fetched from {spec.url} when first asked for")
    try:
        return WeightsPlace(backbone, spec.default_weights())
    except WeightsError as error:
        return WeightsPlace(backbone, None, str(error))
