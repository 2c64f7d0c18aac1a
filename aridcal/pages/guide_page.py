"""The page beside the robot: what is known in large figures, the last row, what to do, the next pose."""

from __future__ import annotations

from markupsafe import Markup

from aridcal.pages.drawing.page_frame import asset, filled


def guide_page(title: str, key: str) -> Markup:
    """The live page; what it shows comes from `/state` of the server that it is from.

    Args:
        title: Of the campaign.
        key: That lets it say something.
    """
    return filled(
        "guide.html", title=title, key=key, style=Markup(asset("guide.css")), script=Markup(asset("guide.js"))
    )
