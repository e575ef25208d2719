"""Pieces of an HTML page that stands alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1c2530; --soft: #4a5562; --rule: #c9d0d8;
  --faint: #e4e8ec; --lost: #a3281f; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14181d; --ink: #e3e8ee; --soft: #a3afbc; --rule: #3d4854; --faint: #28303a;
    --lost: #ff8d80; }
  .js-plotly-plot .main-svg { background: transparent !important; }
  .main-svg .bg, .main-svg .bglayer rect { fill: transparent !important; }
  .main-svg text { fill: var(--ink) !important; }
  .main-svg .gridlayer path { stroke: var(--faint) !important; }
  .main-svg .updatemenu-container text, .main-svg .hoverlayer text { fill: #1c2530 !important; }
  .main-svg .hoverlayer path { fill: #f1f3f6 !important; }
  .modebar-btn path { fill: var(--soft) !important; }
}
body { margin: 0; background: var(--paper); color: var(--ink); line-height: 1.5;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.2rem 4rem; }
h1 { font-size: 1.6rem; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.6rem 0 .6rem; border-bottom: 1px solid var(--rule); }
h3 { font-size: 1rem; margin: 1.8rem 0 .3rem; }
p, li { max-width: 48rem; }
.lead { color: var(--soft); margin-top: 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; }
caption { text-align: left; color: var(--soft); padding-bottom: .3rem; }
th, td { padding: .25rem .8rem .25rem 0; text-align: left; vertical-align: top; }
tbody th { white-space: nowrap; }
thead th { border-bottom: 1px solid var(--ink); font-weight: 600; vertical-align: bottom; }
tbody tr { border-bottom: 1px solid var(--faint); }
th.number, td.number { text-align: right; font-variant-numeric: tabular-nums; }
td.number { white-space: nowrap; }
tr.lost td { color: var(--lost); }
code { font-size: .85em; overflow-wrap: anywhere; }
figure { margin: .8rem 0 1.6rem; }
figure img { max-width: 100%; height: auto; }
figcaption { color: var(--soft); font-size: .88rem; max-width: 48rem; }
.gallery { display: grid; gap: 0 1rem;
  grid-template-columns: repeat(auto-fit, minmax(22rem, 1fr)); }
.gallery figure { margin: .4rem 0 .8rem; }
summary { cursor: pointer; margin: 1.4rem 0 .3rem; font-weight: 600; }
.note { border-left: 3px solid #c98a1b; padding-left: .8rem; }
@media print { h2, h3, figcaption { break-after: avoid; } figure, tr { break-inside: avoid; } }
"""


def document(title: str, *parts: str) -> str:
    """A whole page, with the library that draws its plots in it."""
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            f"<style>{STYLE}</style>",
            f"<script>{get_plotlyjs()}</script>",
            "</head>",
            "<body>",
            "<main>",
            *parts,
            "</main>",
            "</body>",
            "</html>",
            "",
        ]
    )


def heading(level: int, words: str) -> str:
    """A heading."""
    return f"<h{level}>{escape(words)}</h{level}>"


def paragraph(words: str, kind: str = "") -> str:
    """A paragraph of plain words."""
    return f"<p{_class(kind)}>{escape(words)}</p>"


def listing(items: Iterable[str]) -> str:
    """A list of plain words."""
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def facts(values: Mapping[str, str], caption: str = "") -> str:
    """What is what, a line each."""
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in values.items()
        if value
    )
    return f'<div class="wide"><table>{_caption(caption)}<tbody>{rows}</tbody></table></div>'


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    words: int = 1,
    lost: Sequence[bool] = (),
    caption: str = "",
) -> str:
    """A table whose first columns are words and the others numbers.

    Args:
        headings: Of the columns.
        rows: Cells.
        words: Columns of words.
        lost: Rows that are marked; may be empty.
        caption: What the table is.
    """

    def cell(tag: str, place: int, text: str) -> str:
        return f"<{tag}{_class('' if place < words else 'number')}>{escape(text)}</{tag}>"

    head = "".join(cell("th", place, text) for place, text in enumerate(headings))
    body = "".join(
        f"<tr{_class('lost' if number < len(lost) and lost[number] else '')}>"
        + "".join(cell("td", place, text) for place, text in enumerate(row))
        + "</tr>"
        for number, row in enumerate(rows)
    )
    return (
        f'<div class="wide"><table>{_caption(caption)}<thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def plot(figure: go.Figure, caption: str, name: str) -> str:
    """A plot that can be looked at closely.

    Args:
        figure: The plot.
        caption: What it shows.
        name: Its id in the page, which no other has.
    """
    drawn = figure.to_html(
        full_html=False, include_plotlyjs=False, include_mathjax=False, div_id=name,
        config={"displaylogo": False, "responsive": True},
    )  # fmt: skip
    return f"<figure>{drawn}<figcaption>{escape(caption)}</figcaption></figure>"


def image(address: str, caption: str) -> str:
    """A picture."""
    return (
        f'<figure><img src="{escape(address)}" alt="{escape(caption)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def gallery(pieces: Iterable[str]) -> str:
    """Pictures, or small tables, beside each other where there is room."""
    return f'<div class="gallery">{"".join(pieces)}</div>'


def folded(words: str, body: str) -> str:
    """Something long that is only shown when its words are clicked.

    Args:
        words: What it is.
        body: Markup of it.
    """
    return f"<details><summary>{escape(words)}</summary>{body}</details>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def _caption(words: str) -> str:
    return f"<caption>{escape(words)}</caption>" if words else ""
