"""HTML fragments shared by the pages of reports."""

from __future__ import annotations

import html
from collections.abc import Collection, Iterable, Sequence
from importlib import resources

from rover_bags.views.plots import Plot


def escaped(text: object) -> str:
    """Return text escaped for HTML."""
    return html.escape(str(text))


def page_file(name: str) -> str:
    """Return the text of a file beside this module, which a page embeds to open offline."""
    return resources.files("rover_bags.views").joinpath(name).read_text(encoding="utf-8")


def whole_page(title: str, parts: Iterable[str], script: str = "") -> str:
    """Return a self-contained page."""
    tail = f"<script>{script}</script>" if script else ""
    style = page_file("report.css")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escaped(title)}</title><style>{style}</style></head>\n"
        f"<body><main>{''.join(part for part in parts if part)}</main>\n{tail}</body></html>\n"
    )


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Collection[str] = ()
) -> str:
    """Return a table.

    Args:
        head: Headings.
        rows: Cells with their tags, row by row.
        text_columns: Headings of columns that hold text and are aligned left.
    """
    heads = "".join(
        f"<th{' class=words' if text in text_columns else ''}>{escaped(text)}</th>" for text in head
    )
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def plot_grid(plots: Sequence[Plot], prefix: str = "") -> str:
    """Return plots side by side; ``prefix`` makes the identifiers in repeated plots unique."""
    shown = []
    for plot in plots:
        timed = (
            f' data-left="{plot.left:.5f}" data-right="{plot.right:.5f}"'
            f' data-begin="{plot.begin:.5f}" data-end="{plot.end:.5f}"'
            if plot.right > plot.left
            else ""
        )
        kind = "plot wide" if plot.wide else "plot"
        svg = plot.svg
        if prefix:
            for mark in ('id="', 'href="#', "url(#"):
                svg = svg.replace(mark + plot.name, mark + prefix + plot.name)
        svg = svg.replace("<svg", f'<svg role="img" aria-label="{escaped(plot.alt)}"', 1)
        shown.append(f'<figure class="{kind}"{timed}>{svg}</figure>')
    return f'<div class="plots">{"".join(shown)}</div>' if shown else ""
