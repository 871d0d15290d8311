"""MkDocs hook: links from a page to files outside docs/, which the site has not.

With `repo_url` they lead there, else they become plain text. That the files exist is tested elsewhere.
"""

from __future__ import annotations

import posixpath
import re

__all__ = ["on_page_markdown"]

LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")


def on_page_markdown(markdown: str, page, config, files) -> str:
    """The page's text as the site shows it."""
    folder = posixpath.dirname(page.file.src_uri)

    def replaced(link: re.Match) -> str:
        text, target, anchor = link[1], posixpath.normpath(posixpath.join(folder, link[2])), link[3] or ""
        if target.startswith("../"):
            url = config.repo_url
            return f"[{text}]({url.rstrip('/')}/blob/main/{target[3:]}{anchor})" if url else text
        return link[0]

    return LINK.sub(replaced, markdown)
