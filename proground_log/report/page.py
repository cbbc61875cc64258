"""The page: sections of a few kinds of content, and how they become one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from jinja2 import Environment, PackageLoader, StrictUndefined


@dataclass(frozen=True)
class Note:
    """A line of text: what a section has to say, or why it has nothing to show."""

    kind: ClassVar = "note"
    text: str


@dataclass(frozen=True)
class Table:
    """Rows under titles; all columns but the first are figures, set to the right.

    Args:
        titles: one a column.
        rows: as many cells each.
    """

    kind: ClassVar = "table"
    titles: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Figures:
    """Names with a figure each, in as many columns as the window has room for."""

    kind: ClassVar = "figures"
    figures: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Bar:
    """A figure among others of its kind.

    Args:
        name, figure: what it is called, and the figure as text.
        share: length of its bar, 0 to 1.
        color: "#rrggbb" of the bar; None: the page's own.
    """

    name: str
    figure: str
    share: float
    color: str | None = None


@dataclass(frozen=True)
class Bars:
    """Figures with bars, one below the other."""

    kind: ClassVar = "bars"
    bars: Sequence[Bar]


@dataclass(frozen=True)
class Picture:
    """A picture with its title.

    Args:
        title: stands above it.
        uri: the picture itself, as a data URI.
    """

    title: str
    uri: str


@dataclass(frozen=True)
class Charts:
    """Small figures side by side, as many in a row as the window has room for."""

    kind: ClassVar = "charts"
    pictures: Sequence[Picture]


@dataclass(frozen=True)
class Views:
    """Rows of pictures of one frame each, scrolled sideways where the window is narrow."""

    kind: ClassVar = "views"
    frames: Sequence[tuple[str, Sequence[Picture]]]


@dataclass(frozen=True)
class Plan:
    """One large picture."""

    kind: ClassVar = "plan"
    picture: Picture


@dataclass(frozen=True)
class Legend:
    """What colours mean: names with "#rrggbb"."""

    kind: ClassVar = "legend"
    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Commands:
    """Lines for a shell."""

    kind: ClassVar = "commands"
    lines: Sequence[str]


Content = Note | Table | Figures | Bars | Charts | Views | Plan | Legend | Commands


@dataclass(frozen=True)
class Section:
    """A part of the page under a title of its own."""

    title: str
    contents: Sequence[Content]


@dataclass(frozen=True)
class Tile:
    """A figure that the page opens with: its name, value and unit."""

    name: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Page:
    """Everything that the page says.

    Args:
        title: heading and name of the window.
        facts: what made the run, in a few words each.
        tiles: the verdict.
        sections: the rest, in this order.
    """

    title: str
    facts: Sequence[str]
    tiles: Sequence[Tile]
    sections: Sequence[Section]


def whole(count: int) -> str:
    """A count as the page writes it."""
    return f"{count:,}"


def render_page(page: Page) -> str:
    """The page as HTML that needs no other file and no network.

    Whatever it is given is text, never markup: names come from files of others.
    """
    environment = Environment(
        loader=PackageLoader("proground_log.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html").render(page=page)
