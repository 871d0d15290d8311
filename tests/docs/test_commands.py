"""Commands of the documents: each exists, with the options, parameters and files that are named."""

import ast
import re
import shlex
from dataclasses import fields
from importlib import import_module

import pytest
from documents import DOCUMENTS, name_of

from import_graph import ROOT
from physkin_core import cli

MANY = {"--ros-args", "--help", "--debug"}
"""Options that every command or ROS has."""
OF_THEIR_OWN = {
    ("replay", "--live"): ROOT / "physkin_ros" / "tools" / "live.py",
    ("simulate", "--dynamic"): ROOT / "training" / "physkin_training" / "dynamics" / "command.py",
}
"""Commands that take other options with this one: where these are."""


@pytest.fixture(scope="module")
def commands():
    """Command -> its options; None for those whose options only they know."""
    forwarded = {}
    for name, module in cli.FORWARDED.items():
        pytest.importorskip(module, reason="needs pip install 'physkin[ros,replay,training,view]'")
        forwarded[name] = getattr(import_module(module), "command_parser", None)
    parser = cli._parser({name: parser() for name, parser in forwarded.items() if parser})
    choices = next(action.choices for action in parser._actions if isinstance(action.choices, dict))
    options = {name: set(command._option_string_actions) for name, command in choices.items()}
    return {name: None if name in forwarded and not forwarded[name] else found for name, found in options.items()}


def commands_of(document):
    """Command lines in blocks of code and in sentences, split into words."""
    text = document.read_text()
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    lines += re.findall(r"`(physkin [^`]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))
    for line in lines:
        found = re.search(
            r"^(?:.*(?:/bin/|[;&|(] ?))?(physkin\s+[a-z-].*)", re.sub(r"\s+#\s.*", "", line.replace("\n", " "))
        )
        if found:
            yield shlex.split(re.split(r"\s(?:&&|\|\||[|&>])|;", found[1])[0])[1:]


@pytest.mark.parametrize("document", [path for path in DOCUMENTS if path.name != "CHANGELOG.md"], ids=name_of)
def test_commands_exist(document, commands):
    """With their options; placeholders in square brackets stand for options, too."""
    wrong = []
    for name, *words in commands_of(document):
        if name in ("COMMAND", "--debug", "--help"):
            continue
        if name not in commands:
            wrong.append(name)
            continue
        options = {option for word in words if re.fullmatch(r"--?[a-zA-Z][a-z-]*", option := word.strip("[]"))}
        known = commands[name]
        for (command, switch), source in OF_THEIR_OWN.items():
            if name == command and switch in options:
                known = set(re.findall(r"\"(--?[a-z-]+)\"", source.read_text()))
        if known is not None:
            wrong += [f"{name} {option}" for option in options - known - MANY]
    assert wrong == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_parameters_of_the_node_exist(document):
    """Those that a command line sets."""
    settings = pytest.importorskip("physkin_ros.node.settings")
    kinds = settings.NodeSettings, settings.AvatarSettings, settings.GarmentSettings
    known = {field.name for kind in kinds for field in fields(kind)} | {"config"}
    assert set(re.findall(r"(?<=-p )(\w+):=", document.read_text())) - known == set()


@pytest.mark.parametrize("document", DOCUMENTS, ids=name_of)
def test_targets_and_scripts_exist(document):
    """Of make, and of Python in this repository."""
    text, makefile = document.read_text(), (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"(?:^|`)make ([a-z][\w-]*)", text, flags=re.MULTILINE))
    assert {target for target in targets if not re.search(rf"^{target}:", makefile, re.MULTILINE)} == set()
    scripts = set(re.findall(r"python3? ((?:docs|physkin_ros|msg_defs|training|tests|native)/[\w/]+\.py)", text))
    assert {script for script in scripts if not (ROOT / script).exists()} == set()


def test_messages_that_are_explained_are_said():
    """Each quoted part of a sentence stands in the sources, or the words of it between two values."""
    text = (ROOT / "docs" / "troubleshooting.md").read_text()
    quoted = re.findall(r"^\| `([^`]+)` \|", text, flags=re.MULTILINE)
    said = [(ROOT / "native" / "CMakeLists.txt").read_text()]
    for folder in ("physkin_core", "physkin_ros", "training/physkin_training"):
        for path in (ROOT / folder).rglob("*.py"):
            nodes = list(ast.walk(ast.parse(path.read_text())))
            said += [node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)]
            said += ["".join(map(_words, node.values)) for node in nodes if isinstance(node, ast.JoinedStr)]
    text = "\n".join(said)
    assert len(quoted) > 20 and [part for part in quoted if part not in text] == []


def _words(part):
    """Of a piece of an f-string: a value is left out."""
    return part.value if isinstance(part, ast.Constant) else ""
