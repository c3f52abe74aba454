"""Pieces of a page that needs nothing but itself: tables, bars, pictures; every text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:72rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem;margin:0 0 .5rem}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #ddd}
table{border-collapse:collapse;margin:.5rem 0}
th,td{padding:.2rem .8rem .2rem 0;text-align:left;vertical-align:top;font-variant-numeric:tabular-nums}
th{border-bottom:1px solid #bbb;font-weight:600}
tr:nth-child(even) td{background:#f7f7f7}
.note{color:#555}
.wide{overflow-x:auto}
.pictures{display:flex;flex-wrap:wrap;gap:1rem}
figure{margin:0;max-width:22rem}
figure img{width:100%;height:auto}
figcaption{font-size:.85rem;color:#444}
details table td{overflow-wrap:anywhere}
"""


class Markup(str):
    """Text that is HTML already and is not escaped again."""


def to_markup(value: object) -> Markup:
    """A cell or a sentence as HTML."""
    return value if isinstance(value, Markup) else Markup(escape(str(value)))


def make_table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> Markup:
    """A table; `head` may be empty."""
    lines = [_row("th", head)] if head else []
    lines += [_row("td", row) for row in rows]
    return Markup('<div class="wide"><table>' + "".join(lines) + "</table></div>")


def _row(tag: str, cells: Sequence[object]) -> str:
    return "<tr>" + "".join(f"<{tag}>{to_markup(cell)}</{tag}>" for cell in cells) + "</tr>"


def draw_interval(rate: float, low: float, high: float) -> Markup:
    """A rate in [0, 1] as a dot on its interval, on a scale from 0 to 1."""
    left, right, dot = (6 + 128 * value for value in (low, high, rate))
    return Markup(
        '<svg width="140" height="14" role="img" aria-hidden="true">'
        '<line x1="6" x2="134" y1="7" y2="7" stroke="#ddd" stroke-width="2"/>'
        f'<line x1="{left:.1f}" x2="{right:.1f}" y1="7" y2="7" stroke="#1f6fb4" stroke-width="5"/>'
        f'<circle cx="{dot:.1f}" cy="7" r="4.5" fill="#0d3c66"/></svg>'
    )


def make_figure(content: bytes, words: str, *, kind: str = "png", caption: bool = True) -> Markup:
    """A picture's file held in the page; `kind` is png or svg+xml; `words` stand below, or instead of it."""
    # An <img> of its own keeps the identifiers of one SVG apart from another's.
    source = f"data:image/{kind};base64,{base64.b64encode(content).decode()}"
    text = to_markup(words)
    below = f"<figcaption>{text}</figcaption>" if caption else ""
    return Markup(f'<figure><img src="{source}" alt="{text}">{below}</figure>')


def make_gallery(figures: Iterable[Markup]) -> Markup:
    """Figures side by side, as many as fit."""
    return Markup('<div class="pictures">' + "".join(figures) + "</div>")


def make_note(text: object) -> Markup:
    """A line of small importance."""
    return Markup(f'<p class="note">{to_markup(text)}</p>')


def make_section(title: str, *parts: Markup, closed: bool = False) -> Markup:
    """A heading with what stands below it; `closed` sections open on a click."""
    body = "".join(parts)
    if closed:
        return Markup(f"<details><summary>{to_markup(title)}</summary>{body}</details>")
    return Markup(f"<h2>{to_markup(title)}</h2>{body}")


def make_page(title: str, sections: Iterable[Markup]) -> str:
    """A whole document, with its style inside."""
    words = to_markup(title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{words}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{_STYLE}</style></head><body><h1>{words}</h1>{''.join(sections)}</body></html>\n"
    )
