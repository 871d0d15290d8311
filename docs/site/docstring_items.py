"""Extension of griffe, which reads docstrings for the Python reference: parameters and errors become a list.

Docstrings without sections (`Args:` and the like, which griffe reads itself) name a parameter or field, then a colon:
"vertices: (n, 3) [m]. faces: (f, 3)." Errors begin with "Raises".
"""

from __future__ import annotations

import re

import griffe

__all__ = ["DocstringItems", "listed"]

SECTION = re.compile(r"^(Args|Attributes|Returns|Raises):$", flags=re.MULTILINE)


class DocstringItems(griffe.Extension):
    """Lists the items of every function's and class's docstring."""

    def on_function(self, *, func: griffe.Function, **_) -> None:
        """Of a function or method."""
        _list(func, [parameter.name for parameter in func.parameters])

    def on_class(self, *, cls: griffe.Class, **_) -> None:
        """Of a class: what it is made from, and its fields."""
        _list(cls, [parameter.name for parameter in cls.parameters] + list(cls.members))


def listed(text: str, names: list[str]) -> str:
    """A docstring as Markdown, each of the `names` that it explains, and its errors, an item of a list."""
    name = "(?:" + "|".join(map(re.escape, sorted(names, key=len, reverse=True))) + ")" if names else r"(?!)"
    item = rf"(?:(?<=[.;:?!)])|(?<=\A)|(?<=\n))(?:\s|\A)*\b({name}(?:,\s{name})*): "
    paragraphs = []
    for paragraph in text.split("\n\n"):
        if paragraph.startswith((">>>", "    ")):
            paragraphs.append(paragraph)
            continue
        paragraph = re.sub(item, lambda found: f"\n\n- **{found[1]}**: ", paragraph)
        paragraph = re.sub(r"(?:(?<=[.])|\A)\s*\b(Raises|Returns) (?=[A-Z(`])", r"\n\n- **\1** ", paragraph)
        paragraphs.append(paragraph.strip())
    return "\n\n".join(paragraphs)


def _list(documented: griffe.Object, names: list[str]) -> None:
    if documented.docstring and not SECTION.search(documented.docstring.value):
        documented.docstring.value = listed(documented.docstring.value, names)
