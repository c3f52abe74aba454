"""The python blocks of README and documentation run as they stand, each page from top to bottom."""

import re
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[2]
_PAGES = [_ROOT / "README.md", *sorted((_ROOT / "docs").rglob("*.md"))]
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def _blocks(page):
    """(line, code) of each python block."""
    text = page.read_text()
    return [(text[: match.start(1)].count("\n"), match[1]) for match in _BLOCK.finditer(text)]


_WITH_CODE = [page for page in _PAGES if _blocks(page)]


_SLOW = ("collectors.md", "pendulum.md")  # start processes, or train


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.slow] * (page.name in _SLOW)) for page in _WITH_CODE],
    ids=lambda page: str(page.relative_to(_ROOT)),
)
def test_blocks_of_a_page_run(page):
    namespace = {"__name__": "example"}
    for line, code in _blocks(page):
        # The page's own line numbers stand in a traceback.
        exec(compile("\n" * line + code, str(page), "exec"), namespace)


def test_pages_have_code():
    assert len(_WITH_CODE) >= 8


@pytest.mark.parametrize("page", _PAGES, ids=lambda page: str(page.relative_to(_ROOT)))
def test_links_lead_to_files(page):
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text())
    broken = [t for t in targets if "://" not in t and not (page.parent / t).exists()]
    assert not broken
