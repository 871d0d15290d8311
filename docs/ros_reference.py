"""Write `docs/ros-reference.md`: python docs/ros_reference.py

From the node's settings, its topics and the interface files.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from textwrap import fill

from import_graph import ROOT
from physkin_ros.messages.topics import TOPICS
from physkin_ros.node.settings import AvatarSettings, GarmentSettings, NodeSettings, Setting

__all__ = ["REFERENCE", "reference"]

REFERENCE = ROOT / "docs" / "ros-reference.md"
INTERFACES = ROOT / "msg_defs"
HEAD = """# ROS reference

Every parameter, topic, message and service of [the ROS node](node.md).

## Parameters

```
physkin node --ros-args -p model:=skirt:denim -p orientation:=odometry -p sway:=0.5
```

Parameters marked \\* may change while the node runs. The default shows the type; *empty* is an empty string.
"""
NAME = r"(?<![\w`/.])(orientation: \w+|~/\w[\w/]*|/\w[\w/]*|[\w.:]*\w_\w(?:[\w./]*\w)?)(?![\w/`])"
PARTS = (
    ("Of the node", "", NodeSettings),
    (
        "Of each avatar",
        "With a single avatar, set a parameter by its name in this table, such as `body_mesh`. With several, put the "
        "avatar's ID before it: `avatars.ID.body_mesh`. Default topics then [contain the ID](#topics-and-services), "
        "too.",
        AvatarSettings,
    ),
    (
        "Of each garment",
        "With several avatars, put the avatar's ID and the garment's name before it: `avatars.ID.garments.NAME.model`.",
        GarmentSettings,
    ),
)


def reference() -> str:
    """The page."""
    return "\n".join([HEAD, *_parameters(), *_topics(), *_interfaces()]).rstrip() + "\n"


def _parameters() -> Iterator[str]:
    for title, where, kind in PARTS:
        yield f"### {title}\n"
        if where:
            yield f"{fill(where, 120)}\n"
        yield "| parameter | default | |\n|---|---|---|"
        for field in fields(kind):
            if field.metadata:
                yield _parameter(field.name, field.metadata["setting"])
        yield ""


def _parameter(name: str, setting: Setting) -> str:
    default = "empty, or a number" if setting.default is None else _default(setting.default)
    allowed = f" Allowed: {_range(setting)}." if _range(setting) else ""
    mark = " \\*" if setting.changes else ""
    description = re.sub(
        rf"(?<![\w(])({'|'.join(filter(None, setting.choices)) or '(?!)'})\b", r"`\1`", setting.description
    )
    return f"| `{name}`{mark} | {default} | {_cell(description.rstrip('.'))}.{allowed} |"


def _default(value: object) -> str:
    """In such a way that the type is seen."""
    if isinstance(value, list):
        return f"[{', '.join(_default(each) for each in value if each != '')}]"
    return str(value).lower() if isinstance(value, bool) else str(value) or "empty"


def _range(setting: Setting) -> str:
    if setting.choices:
        described = all(re.search(rf"\b{choice or 'Empty'}\b", setting.description) for choice in setting.choices)
        return "" if described else ", ".join(f"`{choice}`" if choice else "empty" for choice in setting.choices)
    return f"{setting.low:.9g} to {setting.high:.9g}" if abs(setting.low) < float("inf") else ""


def _topics() -> Iterator[str]:
    yield "## Topics and services\n"
    note = (
        "These are the names with a single avatar. With several, `joint_states` is `ID/joint_states`, `~/joint_states` "
        "is `~/ID/joint_states`, and the topics of a garment are below `~/ID/NAME`. In the outfit of a single avatar "
        "they are below `~/NAME`. Those of `physkin_msgs` need [this package](node.md#starting-it); the node's page "
        "describes the [quality of service](node.md#keeping-it-running)."
    )
    yield f"{fill(note, 120)}\n"
    yield "| | name | type | | only with |\n|---|---|---|---|---|"
    for topic in TOPICS:
        package, kind = topic.type.split("/")
        link = f"[`{topic.type}`](#{kind.lower()})" if package == "physkin_msgs" else f"`{topic.type}`"
        needs = f"`{topic.needs}`" if topic.needs else ""
        yield f"| {topic.direction} | `{topic.name}` | {link} | {_cell(topic.description)} | {needs} |"
    yield ""


def _interfaces() -> Iterator[str]:
    yield "## Messages and services of `physkin_msgs`\n"
    for path in sorted([*INTERFACES.glob("msg/*.msg"), *INTERFACES.glob("srv/*.srv")]):
        head, parts = _read(path)
        yield f"### {path.stem}\n\n{fill(head, 120)}\n"
        for title, rows in parts.items():
            yield f"| {title} | |\n|---|---|"
            yield from (f"| `{name}`: `{kind}` | {_cell(text)} |" for name, kind, text in rows)
            yield ""


def _read(path: Path) -> tuple[str, Mapping[str, list[tuple[str, str, str]]]]:
    """First comment of an interface file, and by part (field; request and answer of a service) what its fields are."""
    titles = iter(["field"] if path.suffix == ".msg" else ["request", "answer"])
    paragraphs = [part.strip() for part in re.split(r"\n\s*\n|\n(?=---)|(?<=---)\n", path.read_text()) if part.strip()]
    head, parts = _uncommented(paragraphs[0]), {next(titles): []}
    for paragraph in paragraphs[1:]:
        if paragraph == "---":
            parts[next(titles)] = []
            continue
        lines = paragraph.splitlines()
        text = _uncommented("\n".join(line for line in lines if line.startswith("#")))
        text = text.replace(" No unit.", "").replace(" A count.", "")  # in the file each says so; a table need not
        declared = [line.split()[:2] for line in lines if not line.startswith("#")]
        list(parts.values())[-1].extend((name, kind, text) for kind, name in declared)
    return head, parts


def _uncommented(text: str) -> str:
    return " ".join(line.lstrip("# ") for line in text.splitlines())


def _cell(text: str) -> str:
    """Of a table. Names of topics, parameters and types are set as code."""
    return re.sub(NAME, r"`\1`", text).replace("|", "\\|")


if __name__ == "__main__":
    REFERENCE.write_text(reference())
