"""Words of a page that are in sight before anybody clicks: text, tables and figures outside of closed folds."""

from __future__ import annotations

import re

from lxml import html

MOST_WORDS = 2000
"""Words in sight of an ordinary report: some ten minutes of reading."""


def words_in_sight(page: str) -> list[str]:
    """All that holds a letter or a digit, between white space; of a closed fold its title alone."""
    body = html.document_fromstring(page).find("body")
    for element in body.xpath(".//script | .//style | .//details[not(@open)]/*[not(self::summary)]"):
        element.drop_tree()
    return re.findall(r"\S*\w\S*", " ".join(body.itertext()))
