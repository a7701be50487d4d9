"""A film in the report: it stays a file beside the page, which shows it where it is and links to it."""

from __future__ import annotations

import html
from dataclasses import dataclass

from markdown_it import MarkdownIt

POLICY = "; media-src 'self' file:"
"""Added to the page's content security policy where it shows films: nothing else may be loaded from beside it."""


@dataclass(frozen=True)
class Film:
    """A film saved as `figures/<stem>.webm`, with its caption (Markdown).

    It is not inside the page as pictures are: ten films would make a page of 50 MB, which no browser scrolls.
    """

    stem: str
    caption: str

    @property
    def path(self) -> str:
        """Where it is, seen from the report."""
        return f"figures/{self.stem}.webm"


def film_markdown(film: Film) -> str:
    """A link to the film and its caption."""
    return f"**Film.** {film.caption} ([WebM]({film.path}))"


def film_html(film: Film, md: MarkdownIt) -> str:
    """The film with controls, and a link for those whose browser does not play it."""
    path = html.escape(film.path)
    link = f'<a href="{path}">{path}</a>'
    caption = f"<figcaption><b>Film.</b> {md.renderInline(film.caption)} ({link})</figcaption>"
    return f'<figure class="film"><video controls preload="metadata" src="{path}">{link}</video>\n{caption}</figure>'
