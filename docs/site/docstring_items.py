"""Extension of griffe, which reads docstrings for the Python reference: parameters and errors become a list.

Docstrings without sections (`Args:` and the like, which griffe reads itself) name a parameter or field, then a colon:
"vertices: (n, 3) [m]. faces: (f, 3)." Errors begin with "Raises". In sections, several names before a colon become an
item each, as griffe knows one name alone.
"""

from __future__ import annotations

import re

import griffe

__all__ = ["DocstringItems", "listed", "one_by_one"]

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


def one_by_one(text: str, names: list[str]) -> str:
    """A docstring with sections, in which each of the `names` has an item of its own: "a, b: x" is "a: x", "b: x"."""

    def split(found: re.Match) -> str:
        several = found[2].split(", ")
        return (
            "\n".join(f"{found[1]}{name}: {found[3]}" for name in several) if set(several) <= set(names) else found[0]
        )

    return re.sub(r"^( +)(\w+(?:, \w+)+): (.*(?:\n\1 +.*)*)", split, text, flags=re.MULTILINE)


def _list(documented: griffe.Object, names: list[str]) -> None:
    if not documented.docstring:
        return
    arrange = one_by_one if SECTION.search(documented.docstring.value) else listed
    documented.docstring.value = arrange(documented.docstring.value, names)
