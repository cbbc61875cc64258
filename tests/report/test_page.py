"""The page: text stays text, nothing is fetched, the same page gives the same bytes."""

from __future__ import annotations

import re
from base64 import b64decode
from html.parser import HTMLParser

import cv2
import numpy as np

from proground_log.report.figures import (
    depth_picture,
    hex_color,
    jpeg_uri,
    line_chart,
    loss_chart,
    png_uri,
    stage_chart,
    stretches,
)
from proground_log.report.floor_chart import Outline, floor_chart
from proground_log.report.page import (
    Bar,
    Bars,
    Charts,
    Commands,
    Content,
    Figures,
    Legend,
    Note,
    Page,
    Picture,
    Plan,
    Section,
    Table,
    Tile,
    Views,
    render_page,
)

WICKED = "<script>alert('x')</script>\"&"
RNG = np.random.default_rng(0)


class Reader(HTMLParser):
    """Collects the tags, the text and the addresses of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.text += data


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    return reader


def page_with(name: str) -> Page:
    """A page with one of every kind of content, all named alike."""
    picture = Picture(name, png_uri(np.zeros((2, 2, 3), np.uint8)))
    contents: list[Content] = [
        Note(name),
        Table((name, name), [(name, name)]),
        Figures([(name, name)]),
        Bars([Bar(name, name, 0.5), Bar(name, name, 0.25, "#102030")]),
        Charts([picture]),
        Views([(name, [picture])]),
        Plan(picture),
        Legend([(name, "#405060")]),
        Commands([name]),
    ]
    return Page(name, [name], [Tile(name, name, name)], [Section(name, contents)])


def svg_of(uri: str) -> str:
    head, content = uri.split(",")
    assert head == "data:image/svg+xml;base64"
    return b64decode(content).decode()


def image_of(uri: str) -> np.ndarray:
    encoded = np.frombuffer(b64decode(uri.split(",")[1]), np.uint8)
    return cv2.imdecode(encoded, cv2.IMREAD_COLOR_RGB)


def test_names_from_files_are_shown_as_text() -> None:
    page = read(render_page(page_with(WICKED)))
    plain = read(render_page(page_with("name")))
    assert page.tags == plain.tags
    assert "script" not in page.tags
    assert page.text.count(WICKED) == plain.text.count("name") > 15


def test_a_page_fetches_nothing() -> None:
    addresses = read(render_page(page_with("name"))).addresses
    assert len(addresses) == 4
    assert all(address.startswith(("data:image/", "#s")) for address in addresses)


def test_bars_are_as_long_as_their_share_and_of_their_colour() -> None:
    html = render_page(page_with("name"))
    assert 'style="width:50.0%"' in html
    assert 'style="width:25.0%;background:#102030"' in html


def test_stretches_hold_the_mean_and_most_of_the_points() -> None:
    values = RNG.normal(size=1000)
    curve = stretches(values, 10)
    np.testing.assert_allclose(curve.mean, values.reshape(10, 100).mean(axis=1))
    np.testing.assert_allclose(curve.x, np.arange(10) * 100 + 49.5)
    inside = (values.reshape(10, 100) >= curve.low[:, None]) & (
        values.reshape(10, 100) <= curve.high[:, None]
    )
    assert inside.mean() == 0.8
    few = stretches(np.array([3.0, 1.0]))
    assert few.x.tolist() == [0, 1]
    assert few.mean.tolist() == few.low.tolist() == few.high.tolist() == [3, 1]


def charts() -> list[str]:
    x = np.arange(20.0)
    outline = Outline("a $chair", np.array([(0.1, 0.1), (0.3, 0.1), (0.2, 0.3)]), "#ff0000")
    return [
        loss_chart(np.exp(-x)),
        line_chart(x, x, "s", cap=30.0),
        stage_chart(x, {"step": x, "decode": x}, "s", cap=20.0),
        floor_chart(
            np.array([[0, 1], [2, 1]], np.uint8), np.zeros(2), 0.2, ("x", "y"), x[:4, None] * 0.1
            + np.zeros((4, 2)), [outline]
        ),
    ]  # fmt: skip


def test_charts_are_the_same_bytes_and_follow_the_page_from_light_to_dark() -> None:
    first = charts()
    assert first == charts()
    for chart in map(svg_of, first):
        assert "prefers-color-scheme:dark" in chart
        assert "currentColor" in chart
        assert "#010203" not in chart
        assert not re.search(r"\b20\d\d-\d\d-\d\d", chart)
        assert not re.search(r"(href|src)=\"(?!#|data:)", chart)


def test_a_loss_that_falls_far_is_drawn_on_a_log_scale() -> None:
    steep, flat = np.geomspace(100, 0.01, 50), np.linspace(2, 1, 50)
    # A power of ten is written with a raised exponent, in a group of its own.
    assert svg_of(loss_chart(steep)).count("10^{") > 1
    assert "10^{" not in svg_of(loss_chart(flat))


def test_pictures_keep_their_colours() -> None:
    image = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    assert np.array_equal(image_of(png_uri(image)), image)
    smooth = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    assert np.abs(image_of(jpeg_uri(smooth)).astype(int) - smooth).max() <= 4
    assert hex_color(smooth[0, 0]) == "#c86432"


def test_depth_goes_from_red_to_blue_and_is_black_where_there_is_none() -> None:
    near, far, nothing = depth_picture(np.array([[0.2, 4.0, 0.0]], np.float32), 4.0)[0].astype(int)
    assert near[0] > near[2]
    assert far[2] > far[0]
    assert not nothing.any()
