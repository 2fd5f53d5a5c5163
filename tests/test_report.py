"""The page: whole, valid, self-contained, readable without pictures; the printed values beside ours."""

import base64
import html.parser
import io
import re
import shutil
import struct
import subprocess

import pytest
from PIL import Image

from legsim import report
from legsim.errors import LegsimError
from legsim.report import FileNote, MethodScore, Picture, ReportContent, Section, Table

VOID = {"meta", "link", "img", "br"}


def tiny_png() -> bytes:
    stream = io.BytesIO()
    Image.new("RGB", (31, 17), "white").save(stream, "PNG")
    return stream.getvalue()


@pytest.fixture
def content():
    scores = [MethodScore(m, r, s, 0.02, 9.0) for m, s in (("uncorrected", 0.8), ("mine", 0.95)) for r in ("leg", "shank", "thigh")]
    return ReportContent(
        "Scan of <Subject & Co>",
        ("SSIM 0.95 > 0.8",),
        (
            Section("Quality", ("A line.",), report.quality_tables(scores), (Picture("Slices", tiny_png(), alt='bones "in" slices'),)),
            Section("Markers", (), (Table("Residuals", ("marker", "RMS (mm)"), (("right",), ("R.Knee", "3.1"))),)),
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
    page = Page(report.render(content))
    assert page.stack == []
    assert {"html", "head", "title", "main", "h1"} <= {tag for tag, _ in page.tags}
    assert page.all("html")[0]["lang"] == "en"


def test_text_is_escaped_and_all_there(content):
    text = report.render(content)
    assert "Scan of &lt;Subject &amp; Co&gt;" in text
    words = " ".join(Page(text).words)
    for expected in ("SSIM 0.95 > 0.8", "A line.", "R.Knee", "3.1", "A sensor is not seen.", "0.1.0"):
        assert expected in words


def test_nothing_is_fetched_from_anywhere(content):
    text = report.render(content)
    assert not re.search(r"https?:|//[a-z]|@import|url\(|<script|srcset", text)
    for tag, attributes in Page(text).tags:
        for name in ("src", "href"):
            address = attributes.get(name)
            assert address is None or address.startswith(("data:", "#")) or tag == "a", address
    assert {"href": "volume-rigid%20imu.mha"} in Page(text).all("a")


def test_every_image_decodes_and_has_words_and_its_size(content):
    images = Page(report.render(content)).all("img")
    assert len(images) == 1
    for image in images:
        data = base64.b64decode(image["src"].removeprefix("data:image/png;base64,"), validate=True)
        with Image.open(io.BytesIO(data)) as picture:
            picture.load()
            assert (str(picture.width), str(picture.height)) == (image["width"], image["height"])
        assert image["alt"] == 'bones "in" slices'
    assert Picture("Only a caption", tiny_png()).size == (31, 17)


def test_a_row_of_one_cell_heads_its_group(content):
    heads = [attributes for attributes in Page(report.render(content)).all("th") if attributes.get("scope") == "rowgroup"]
    assert heads == [{"scope": "rowgroup", "colspan": "2"}]


def test_a_table_with_a_short_row_is_refused():
    with pytest.raises(LegsimError, match="3 columns but a row of 2 cells"):
        Table("Residuals", ("a", "b", "c"), (("x", "y"),))


def test_printed_values_stand_beside_ours():
    scores = [
        MethodScore("rigid", "leg", 0.9876, 0.0123, 9.1234, 0.004, 0.003, 0.002, count=7),
        MethodScore("rigid", "shank", 0.9, 0.1, 8.5),
        MethodScore("mine", "leg", 0.5, 0.2, 9.9),
    ]
    ssim, rmse, entropy = report.quality_tables(scores, condition="30")
    assert ssim.columns == ("method", "SSIM leg", "printed", "SSIM shank", "printed")
    assert ssim.rows[0] == ("rigid", "0.988 ± 0.004", "0.993 ± 0.003", "0.900", "0.993 ± 0.004")
    assert ssim.rows[1] == ("mine", "0.500", "–", "–", "–")
    assert rmse.rows[0] == ("rigid", "0.012 ± 0.003", "0.015 ± 0.005", "0.100", "0.015 ± 0.005")
    assert "30 degree" in ssim.note
    assert entropy.columns == ("method", "leg", "shank")
    assert entropy.rows == (("rigid", "9.123 ± 0.002", "8.500"), ("mine", "9.900", "–"))


@pytest.mark.parametrize("cell", ["3.1", "-0.5", "–", "−2", "0.98 ± 0.01", "+3 %", "<0.1"])
def test_numbers_are_set_to_the_right(cell):
    table = Table("t", ("a", "b"), (("x", cell),))
    page = Page(report.render(ReportContent("t", (), (Section("s", (), (table,)),))))
    assert page.all("td") == [{"class": "number"}]


@pytest.mark.parametrize("cell", ["tibia_r", "", "- none"])
def test_words_are_not(cell):
    table = Table("t", ("a", "b"), (("x", cell),))
    page = Page(report.render(ReportContent("t", (), (Section("s", (), (table,)),))))
    assert page.all("td") == [{}]


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_a_browser_shows_it_without_complaint_and_without_sideways_scrolling(content, tmp_path, width):
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    # the page reports its own width in its title: the tables scroll inside, the page does not
    probe = "<script>document.title = document.documentElement.scrollWidth + ' of ' + document.documentElement.clientWidth</script></body>"
    page = tmp_path / "report.html"
    page.write_text(report.render(content).replace("</body>", probe), "utf-8")
    flags = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update --disable-sync"
    where = [
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--window-size={width},900",
        "--enable-logging=stderr",
        "--dump-dom",
        page.as_uri(),
    ]
    outcome = subprocess.run([chromium, *flags.split(), *where], capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in outcome.stderr
    found = re.search(r"<title>(\d+) of (\d+)</title>", outcome.stdout)
    assert found
    assert int(found[1]) <= int(found[2])


def test_png_sizes_come_from_the_header():
    data = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 640, 480)
    assert Picture("x", data).size == (640, 480)
