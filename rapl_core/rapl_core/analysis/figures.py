"""Figures of the report, as SVG text that reads on a light and on a dark page.

Text and axes are drawn in ``currentColor``, so they take the colour of the page around them.
"""

import hashlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

INK = "#010203"
"""Stands for the page's text colour until the SVG is written."""
BLUE, ORANGE, GREEN, GREY = "#3b82c4", "#e0752d", "#3a9a6b", "#8a8f98"

_STYLE: Any = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "rapl",
}


@dataclass(frozen=True)
class NamedCurve:
    """A success curve and what to call it."""

    label: str
    steps: NDArray[np.float64]
    """(P,) world steps."""
    success: NDArray[np.float64]
    """(P,) in [0, 1]."""
    dashed: bool = False


def traces_figure(
    rows: Sequence[tuple[str, NDArray[np.float64], NDArray[np.float64] | None]], name: str
) -> str:
    """Draw several videos' rewards over time on one pair of axes, r* beside.

    :param rows: (label, (T,) reward, (T,) r* or None) of each video.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8.4, 2.7), layout="constrained")
        left, right = figure.subplots(1, 2)
        colours = [GREEN, BLUE, GREY, ORANGE, "#b04a8f", "#7a5ac0"]
        for (label, reward, human), colour in zip(rows, colours, strict=False):
            steps = np.arange(1, len(reward) + 1)
            left.plot(steps, reward, color=colour, lw=1.8, label=label)
            if human is not None:
                right.plot(steps, human, color=colour, lw=1.8)
        left.set(title=f"reward by {name}", xlabel="step")
        right.set(title="the human's reward r* (m)", xlabel="step")
        figure.legend(loc="outside lower center", ncols=min(4, len(rows)), frameon=False)
        return _svg(figure)


def plan_figure(plan: NDArray[np.float64], title: str) -> str:
    """Draw a transport plan: rows are the video's frames, columns the expert's.

    :param plan: (T, S) couplings; drawn as multiples of the uniform plan's 1 / (T S).
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(2.9, 2.6), layout="constrained")
        axes = figure.subplots()
        density = plan * plan.size / max(plan.sum(), 1e-300)
        top = max(2.0, float(np.quantile(density, 0.995)))
        image = axes.imshow(density, cmap="viridis", vmin=0.0, vmax=top, aspect="auto")
        image.set_interpolation("nearest")
        axes.set(xlabel="expert frame", ylabel="video frame", title=title)
        bar = figure.colorbar(image, ax=axes, shrink=0.9)
        bar.outline.set_visible(False)
        return _svg(figure)


def success_figure(
    curves: Sequence[NamedCurve], title: str = "", marks: Sequence[tuple[int, str]] = ()
) -> str:
    """Draw success over world steps.

    :param marks: world steps at which something happened, and in a word what.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(6.4, 3.0), layout="constrained")
        axes = figure.subplots()
        draw_success(axes, curves, marks)
        axes.set(title=title)
        return _svg(figure)


def draw_success(
    axes: Axes, curves: Sequence[NamedCurve], marks: Sequence[tuple[int, str]] = ()
) -> None:
    """Draw success over world steps on the axes of a figure with constrained layout.

    See :func:`success_figure`.
    """
    for steps, what in marks:
        axes.axvline(steps, color=GREEN, lw=1.0, ls=":", zorder=0)
        axes.annotate(
            what, (steps, 0.0), (2, 3), xycoords=("data", "axes fraction"),
            textcoords="offset points", rotation=90, va="bottom", fontsize=7, color=GREEN,
        )  # fmt: skip
    colours = cycle((BLUE, ORANGE, GREEN))
    for curve in curves:
        colour = GREY if curve.dashed else next(colours)
        axes.plot(
            curve.steps,
            100 * curve.success,
            "--o" if curve.dashed else "-o",
            color=colour,
            lw=1.8,
            ms=4,
            label=curve.label,
            clip_on=False,
        )
    axes.set(xlabel="world steps", ylabel="success (%)", ylim=(0, 100))
    axes.set_xlim(left=0)
    _grid(axes)
    # below the axes: a curve may lie anywhere within
    axes.figure.legend(loc="outside lower center", ncols=min(3, len(curves)) or 1, frameon=False)


def bars_figure(
    names: Sequence[str], counts: Sequence[int], strengths: Sequence[float | None]
) -> str:
    """Draw the pool: videos of each behaviour, and how the ranker liked them.

    :param strengths: mean preference of each behaviour's ranked videos, None if none was ranked.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8.4, 0.7 + 0.27 * len(names)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        rows = np.arange(len(names))
        left.barh(rows, counts, color=BLUE, height=0.7)
        left.set(yticks=rows, yticklabels=list(names), xlabel="videos")
        left.invert_yaxis()
        known = [(r, s) for r, s in zip(rows, strengths, strict=True) if s is not None]
        if known:
            right.barh(
                [r for r, _ in known],
                [s for _, s in known],
                color=[GREEN if s >= 0 else ORANGE for _, s in known],
                height=0.7,
            )
        right.axvline(0, color=INK, lw=0.8)
        right.set(xlabel="preference, mean over its ranked videos")
        return _svg(figure)


def _grid(axes: Axes) -> None:
    axes.grid(axis="y", color=GREY, alpha=0.3, lw=0.6)
    axes.set_axisbelow(True)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.patch.set_alpha(0.0)
    for axes in figure.axes:
        axes.patch.set_alpha(0.0)
    FigureCanvasSVG(figure)
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return _unique_ids(svg)


def _unique_ids(svg: str) -> str:
    """Keep the ids of several figures on one page apart."""
    prefix = f"f{hashlib.sha256(svg.encode()).hexdigest()[:8]}-"
    svg = re.sub(r'\bid="', f'id="{prefix}', svg)
    svg = re.sub(r'href="#', f'href="#{prefix}', svg)
    return re.sub(r"url\(#", f"url(#{prefix}", svg)
