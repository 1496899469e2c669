"""Scripted behaviours, preferred and disliked."""

from rapl_core.demonstrators.behaviour import Behaviour
from rapl_core.demonstrators.collecting import collect
from rapl_core.demonstrators.demonstrator import (
    Demonstrator,
    behaviour_names,
    behaviours_of,
    draw_behaviours,
    make_demonstrator,
    preferred_behaviours,
)

__all__ = [
    "Behaviour",
    "Demonstrator",
    "behaviour_names",
    "behaviours_of",
    "collect",
    "draw_behaviours",
    "make_demonstrator",
    "preferred_behaviours",
]
