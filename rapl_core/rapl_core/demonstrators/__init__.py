"""Scripted behaviours, preferred and disliked."""

from rapl_core.demonstrators.collecting import collect
from rapl_core.demonstrators.demonstrator import (
    Demonstrator,
    behaviour_names,
    draw_behaviours,
    make_demonstrator,
)

__all__ = ["Demonstrator", "behaviour_names", "collect", "draw_behaviours", "make_demonstrator"]
