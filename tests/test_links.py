"""Relative links of the Markdown files point to files, and to headings, that exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / name
    for name in (
        "README.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "meshes/README.md",
        "tests/README.md",
    )
] + sorted((ROOT / "docs").rglob("*.md"))
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)(?:#([^)\s]+))?\)")


def prose(page):
    """Return a page without its blocks of code."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page):
    """Return what GitHub and MyST name a page's headings by."""
    headings = re.findall(r"^#+ (.*)$", prose(page), flags=re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def assert_made_by_a_script(target):
    """A picture of the gallery is named after the script that draws it."""
    picture = re.search(r"_generated/(\w+)/images/sphx_glr_(\w+)_\d{3}\.png$", target)
    if picture:
        folder = {"gallery": "examples", "verification": "docs/verification"}[picture[1]]
        assert (ROOT / folder / f"{picture[2]}.py").is_file(), f"no script draws {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_relative_links_point_to_what_exists(page):
    """Files made by the documentation's build are not checked: the build itself checks them."""
    for target, anchor in LINK.findall(prose(page)):
        if "_generated/" in target:
            assert_made_by_a_script(target)
            continue
        there = page.parent / target if target else page
        assert there.exists(), f"{target} is not there"
        assert not anchor or anchor in anchors(there), f"{target} has no heading {anchor}"


def test_every_failure_that_must_not_come_back_has_its_tests():
    """The tables name tests by file and function: each row names at least one, and all exist."""
    text = (ROOT / "tests" / "README.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| ") and "cause |" not in line]
    assert len(rows) > 40
    for row in rows:
        named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", row)
        assert named, row
        for file, test in named:
            assert f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8"), test


def test_links_are_found_and_a_missing_heading_is_noticed(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A title: of words\n\n[x](page.md#a-title-of-words) ![y](no.png)\n")
    assert LINK.findall(prose(page)) == [("page.md", "a-title-of-words"), ("no.png", "")]
    assert anchors(page) == {"a-title-of-words"}
    with pytest.raises(AssertionError, match="no script draws"):
        assert_made_by_a_script("_generated/gallery/images/sphx_glr_none_001.png")
