"""One look for all plots: sizes, fonts, colours that colour-blind readers can tell apart, and SVG for embedding."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

#: Inches; at the report's width one inch is about 2.6 cm on paper.
WIDTH_IN = 10.0

_RAISED = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

INK = "#1f2933"
MUTED = "#7b8794"
GRID = "#e4e7eb"
WASH = "#f7f8fa"
ALARM = "#b42318"
CAUTION = "#b7791f"

#: Hues for goals that are named after a colour: a reader expects the red cup to be red.
_NAMED = {
    "red": "#bd1422",
    "blue": "#3e77d0",
    "green": "#39ab58",
    "orange": "#d05f0a",
    "yellow": "#b9b03f",
    "purple": "#9e0895",
    "black": "#1f2933",
    "white": "#9aa5b1",
    "grey": "#7b8794",
    "gray": "#7b8794",
}
#: Okabe and Ito's palette without its yellow, which is invisible on white; order by contrast between neighbours.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#5c4b8a", "#4d4d4d")
#: Classes of motions: other colours than those of goals, which stand beside them (Tol's muted ones; those with the same
#: dashes differ in lightness).
CLASSES = ("#332288", "#117733", "#882255", "#aa4499", "#999933", "#44aa99", "#cc6677", "#6699cc")
#: Second cue beside colour, for print in grey and for more series than colours.
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (5, 1.5, 1.2, 1.5)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

_STYLE: Mapping[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 9.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlecolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.width": 0.8,
    "ytick.major.width": 0.8,
    "text.color": INK,
    "text.parse_math": False,  # names are drawn as they are
    "lines.linewidth": 1.7,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "none",
    "axes.facecolor": "white",
    "savefig.facecolor": "none",
    "svg.fonttype": "path",  # a report looks the same where the font is not installed
    "svg.hashsalt": "humanpred_ros",  # same run, same file
}


@contextmanager
def report_style() -> Iterator[None]:
    """Put the plots' style in force; plots are made and turned into SVG inside."""
    style: Any = dict(_STYLE)
    with mpl.rc_context(style):
        yield


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Return an empty figure that arranges its axes by itself."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def new_panel(height_in: float, width_in: float = WIDTH_IN) -> tuple[Figure, Axes]:
    """Return an empty figure with one pair of axes."""
    figure = new_figure(height_in, width_in)
    return figure, figure.add_subplot()


def label_above(axes: Axes, x: float, text: str, colour: str, *, align: str = "left", y: float = 1.04) -> None:
    """Write above the axes, at `x` in data and `y` in units of the axes' height."""
    axes.annotate(
        text, (x, y), xycoords=("data", "axes fraction"), ha=align, va="bottom", fontsize=8, color=colour
    )  # fmt: skip


def plain_powers(axis: Axis) -> None:
    """Write the numbers at a logarithmic axis without the markup that is off here: 10³, 2×10⁻¹."""
    axis.set_major_formatter(_Powers())
    axis.set_minor_formatter(_Powers(labelOnlyBase=False))


class _Powers(LogFormatterSciNotation):
    def __call__(self, x: float, pos: int | None = None) -> str:
        if x == 0.0:
            return "0"
        text = str(super().__call__(x, pos)).replace("\\times", "×").replace("$\\mathdefault{", "").removesuffix("}$")
        return re.sub(r"\^\{(.*?)\}", lambda power: power[1].translate(_RAISED), text)


def legend_beside(axes: Axes, **what: Any) -> None:
    """Put the legend on the right of the axes."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), **what)


def svg_of(figure: Figure, key: str) -> str:
    """Return the figure as an SVG element for embedding in HTML.

    It scales with the page (a viewBox and no size), and its ids begin with `key`, so that several of them
    can stand in one page.
    """
    buffer = io.StringIO()
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(buffer, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'(<svg\b[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg\b[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{key}-', text)
    text = text.replace("url(#", f"url(#{key}-").replace('xlink:href="#', f'xlink:href="#{key}-')
    return text.strip()


#: Labels of axes along which time, or the number of the replanning step, runs.
TIME, STEP = "time", "step"


def time_axes(figure: Figure) -> list[dict[str, Any]]:
    """Return where time runs in a figure that was drawn: shares of width and height, from above, and the limits."""
    found = []
    for axes in figure.axes:
        if axes.get_label() in (TIME, STEP):
            box, (low, high) = axes.get_position(), axes.get_xlim()
            place = [round(float(v), 4) for v in (box.x0, 1.0 - box.y1, box.width, box.height)]
            found.append({"kind": axes.get_label(), "box": place, "from": float(low), "to": float(high)})
    return found


def goal_colours(names: Iterable[str]) -> dict[str, str]:
    """Return one colour per goal: the hue it is named after, else the next of the series that is still free."""
    names = tuple(names)
    colours = {name: colour for name in names if (colour := _named_colour(name)) is not None}
    if len(set(colours.values())) < len(colours):  # two goals of one hue would look alike
        colours = {}
    free = [colour for colour in SERIES if colour not in colours.values()]
    others = [name for name in names if name not in colours]
    colours.update({name: free[k % len(free)] for k, name in enumerate(others)})
    return {name: colours[name] for name in names}


def class_title(label: str) -> str:
    """Return what a class is called in a sentence: its label, or "class 3" where that is a number."""
    return f"class {label}" if label.isdigit() else label


def class_style(index: int) -> dict[str, Any]:
    """Return colour and dashes of the class at `index` of the sorted labels."""
    return {"color": CLASSES[index % len(CLASSES)], "linestyle": DASHES[index % len(DASHES)]}


def empty_figure(text: str) -> Figure:
    """Return a low figure that says why there is nothing to draw; a page shows its label instead."""
    figure = new_figure(0.6)
    figure.set_label(text)
    note(figure.add_subplot(), text)
    return figure


def note(axes: Axes, text: str) -> None:
    """Write into the middle of empty axes why they are empty."""
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.set_facecolor(WASH)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0.5, 0.5, text, ha="center", va="center", color=MUTED, transform=axes.transAxes)


def _named_colour(name: str) -> str | None:
    words = re.split(r"[^a-z]+", name.lower())
    return next((colour for word, colour in _NAMED.items() if word in words), None)
