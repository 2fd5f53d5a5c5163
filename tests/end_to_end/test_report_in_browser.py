"""Headless Chromium opens a study's report: no complaint, every picture, no sideways scrolling, and
it prints.
"""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync "
    "--enable-logging=stderr --v=0"
)
# a page in a frame of a phone's width: the window itself cannot be that narrow
PROBE = """<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,">
<iframe id="frame" src="{address}" style="width:{width}px;height:800px;border:0"></iframe><p id="found"></p>
<script>
document.getElementById("frame").onload = event => {{
  const page = event.target.contentDocument, images = [...page.images], root = page.documentElement;
  const shown = images.filter(image => image.complete && image.naturalWidth > 0);
  const scrolled = element => element.closest(".scroll, .wide");
  const outside = [...page.querySelectorAll("body *")].filter(e => !scrolled(e) && e.getBoundingClientRect().right > {width} + 1);
  const found = [shown.length, images.length, root.scrollWidth, root.clientWidth, outside.length];
  document.getElementById("found").textContent = found.join(" ");
}};
</script>"""
BAD = """<!DOCTYPE html><link rel="icon" href="data:,"><body><img src="data:image/png;base64,AAAA"><div style="width:900px">x</div>
<script>nothing.here()</script>"""


@pytest.fixture(scope="module")
def chromium() -> str:
    found = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if found is None:
        pytest.skip("no Chromium on this machine")
    return found


def run(chromium: str, profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [chromium, *FLAGS.split(), f"--user-data-dir={profile}", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


def opened(chromium: str, page: Path, tmp_path: Path, width: int) -> tuple[str, list[int]]:
    """What the console said; pictures shown, pictures, width of the page, width to see, and how
    much sticks out.
    """
    probe = page.parent / f"probe-{width}.html"
    probe.write_text(PROBE.format(address=page.name, width=width), "utf-8")
    outcome = run(
        chromium,
        tmp_path / "profile",
        "--allow-file-access-from-files",
        "--virtual-time-budget=20000",
        "--dump-dom",
        probe.as_uri(),
    )
    found = re.search(r'<p id="found">([\d ]+)</p>', outcome.stdout)
    assert found, outcome.stdout[-500:]
    return "\n".join(line for line in outcome.stderr.splitlines() if "CONSOLE" in line), [
        int(n) for n in found[1].split()
    ]


@pytest.mark.parametrize("width", [360, 1280])
def test_it_opens_without_complaint_whole_and_without_sideways_scrolling(
    chromium, written_study, tmp_path, width
):
    console, (shown, pictures, page_width, seen_width, sticking_out) = opened(
        chromium, written_study.folder / "report.html", tmp_path, width
    )
    assert console == ""
    assert shown == pictures == 6
    assert page_width <= seen_width <= width
    assert seen_width > width - 20  # but for a scroll bar
    assert sticking_out == 0


def test_the_probe_sees_what_is_wrong(chromium, tmp_path):
    page = tmp_path / "bad.html"
    page.write_text(BAD)
    console, (shown, pictures, page_width, seen_width, sticking_out) = opened(
        chromium, page, tmp_path, 360
    )
    assert "nothing is not defined" in console
    assert (shown, pictures) == (0, 1)
    assert page_width > seen_width
    assert sticking_out > 0


def test_it_prints(chromium, written_study, tmp_path):
    run(
        chromium,
        tmp_path / "profile",
        f"--print-to-pdf={tmp_path / 'page.pdf'}",
        (written_study.folder / "report.html").as_uri(),
    )
    paper = (tmp_path / "page.pdf").read_bytes()
    assert paper.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", paper)) > 5
