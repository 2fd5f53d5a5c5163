"""The page: whole, valid, self-contained, readable without pictures."""

import base64
import html.parser
import io
import re
import struct

import pytest
from PIL import Image

from legsim.core.errors import LegsimError
from legsim.report import page as report_page
from legsim.report.page import FileNote, PageSection, Picture, ReportContent, Table

VOID = {"meta", "link", "img", "br"}


def tiny_png() -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (31, 17), "white").save(stream, "PNG")
    return stream.getvalue()


@pytest.fixture
def content():
    quality = Table(
        "SSIM",
        ("method", "leg", "published leg"),
        (("uncorrected", "0.800", "0.774"), ("mine", "0.950", "–")),
    )
    return ReportContent(
        "Scan of <Subject & Co>",
        ("SSIM 0.95 > 0.8",),
        (
            PageSection(
                "Quality",
                ("A line.",),
                (quality,),
                (Picture("Slices", tiny_png(), alt='bones "in" slices'),),
            ),
            PageSection(
                "Markers",
                (),
                (Table("Residuals", ("marker", "RMS (mm)"), (("right",), ("R.Knee", "3.1"))),),
            ),
        ),
        (("legsim", "0.1.0"),),
        (FileNote("volume-rigid imu.mha", "volume"),),
        ("A sensor is not seen.",),
    )


class Page(html.parser.HTMLParser):
    """Tags with their attributes, and whether they close in order."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.stack, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.stack.append(tag)

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        if self.stack and self.stack[-1] != "style":
            self.words.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def test_the_page_parses_and_closes_all_it_opens(content):
    page = Page(report_page.render(content))
    assert page.stack == []
    assert {"html", "head", "title", "main", "h1"} <= {tag for tag, _ in page.tags}
    assert page.all("html")[0]["lang"] == "en"


def test_text_is_escaped_and_all_there(content):
    text = report_page.render(content)
    assert "Scan of &lt;Subject &amp; Co&gt;" in text
    words = " ".join(Page(text).words)
    for expected in (
        "SSIM 0.95 > 0.8",
        "A line.",
        "R.Knee",
        "3.1",
        "A sensor is not seen.",
        "0.1.0",
    ):
        assert expected in words


def test_nothing_is_fetched_from_anywhere(content):
    text = report_page.render(content)
    assert not re.search(r"https?:|//[a-z]|@import|url\(|<script|srcset", text)
    for tag, attributes in Page(text).tags:
        for name in ("src", "href"):
            address = attributes.get(name)
            assert address is None or address.startswith(("data:", "#")) or tag == "a", address
    assert {"href": "volume-rigid%20imu.mha"} in Page(text).all("a")


def test_every_image_decodes_and_has_words_and_its_size(content):
    images = Page(report_page.render(content)).all("img")
    assert len(images) == 1
    for image in images:
        data = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"), validate=True)
        with Image.open(io.BytesIO(data)) as picture:
            picture.load()
            assert (str(picture.width), str(picture.height)) == (image["width"], image["height"])
        assert image["alt"] == 'bones "in" slices'
    assert Picture("Only a caption", tiny_png()).size == (31, 17)


def test_a_row_of_one_cell_heads_its_group(content):
    heads = [
        attributes
        for attributes in Page(report_page.render(content)).all("th")
        if attributes.get("scope") == "rowgroup"
    ]
    assert heads == [{"scope": "rowgroup", "colspan": "2"}]


def test_a_table_with_a_short_row_is_refused():
    with pytest.raises(LegsimError, match="3 columns but a row of 2 cells"):
        Table("Residuals", ("a", "b", "c"), (("x", "y"),))


def test_rows_are_linked_by_their_heads():
    table = Table(
        "Scans", ("scan", "SSIM"), (("group",), ("a", "1"), ("b", "2")), links=("", "runs/a b", "")
    )
    text = report_page.render(ReportContent("t", (), (PageSection("s", (), (table,)),)))
    assert '<th scope="row"><a href="runs/a%20b">a</a></th>' in text
    assert '<th scope="row">b</th>' in text


def test_links_are_one_a_row():
    with pytest.raises(LegsimError, match="2 rows but 1 links"):
        Table("Scans", ("scan", "SSIM"), (("a", "1"), ("b", "2")), links=("runs/a",))


@pytest.mark.parametrize("cell", ["3.1", "-0.5", "–", "−2", "0.98 ± 0.01", "+3 %", "<0.1"])
def test_numbers_are_set_to_the_right(cell):
    table = Table("t", ("a", "b"), (("x", cell),))
    page = Page(report_page.render(ReportContent("t", (), (PageSection("s", (), (table,)),))))
    assert page.all("td") == [{"class": "number"}]


@pytest.mark.parametrize("cell", ["tibia_r", "", "- none"])
def test_words_are_not(cell):
    table = Table("t", ("a", "b"), (("x", cell),))
    page = Page(report_page.render(ReportContent("t", (), (PageSection("s", (), (table,)),))))
    assert page.all("td") == [{}]


def test_png_sizes_come_from_the_header():
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 640, 480)
    assert Picture("x", data).size == (640, 480)
