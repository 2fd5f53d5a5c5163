"""Links of the documents lead somewhere, in the checkout and on the site."""

import re
from pathlib import Path

import pytest

from tools import docs_site

ROOT = docs_site.ROOT
PAGES = sorted({*docs_site.outside(), *(f"docs/{p.name}" for p in (ROOT / "docs").glob("*.md"))})


def sections(path: Path) -> set[str]:
    """Names of a page's sections as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere_in_the_checkout(page: str):
    text = re.sub(r"^```.*?^```", "", (ROOT / page).read_text("utf-8"), flags=re.M | re.S)
    for link in re.findall(r"\]\((?![a-z]+:)([^)\s]+)\)", text):
        target, _, section = link.partition("#")
        there = (ROOT / page).parent / target if target else ROOT / page
        assert there.exists(), link
        assert not section or section in sections(there), link


def test_links_are_turned_to_where_the_site_has_the_page():
    text = "[a](docs/design.md#x) [docs/design.md](docs/design.md) [c](legsim/config) [d](#here)"
    assert docs_site.turned(text, "README.md") == (
        "[a](design.md#x) [Design](design.md) [c](api/config.md) [d](#here)"
    )
    assert (
        docs_site.turned("[m](../motions/README.md)", "docs/study.md") == "[m](motions/README.md)"
    )
    fenced = "```\n[a](nowhere)\n```\n"
    assert docs_site.turned(fenced, "README.md") == fenced


def test_a_link_to_what_the_site_lacks_is_refused():
    with pytest.raises(ValueError, match="Makefile"):
        docs_site.turned("[m](Makefile)", "README.md")


def test_every_public_name_has_its_place_in_the_reference():
    where = dict(docs_site.names(docs_site.FACE / "__init__.pyi"))
    for name, module in where.items():
        if name != "__version__":
            assert name in docs_site.public(module.split(".")[0])
    assert "Figure" not in docs_site.public("figures")
