"""A report's page as tests read it."""

from __future__ import annotations


def part(page: str, key: str) -> str:
    """What a page has below the heading of a section, up to the next section."""
    assert f'<h2 id="{key}">' in page, key
    return page.partition(f'<h2 id="{key}">')[2].partition("<h2 ")[0]
