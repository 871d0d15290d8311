"""`physkin replay` of a folder of bags: each into a folder of its own, one page over all, nothing done twice."""

from __future__ import annotations

import json
import shutil
import signal

import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from physkin_core import cli  # noqa: E402
from physkin_ros.replay import many_bags  # noqa: E402


@pytest.fixture
def bags(bag, tmp_path, draper, quick, monkeypatch):
    """Two bags and a file that is none; the garment is bound once, and nothing is plotted."""
    monkeypatch.setattr("physkin_ros.replay.command._draper", lambda _: draper)
    monkeypatch.setattr("physkin_ros.replay.report._plots", lambda _: "")
    folder = tmp_path / "bags"
    folder.mkdir()
    for name in ("one.mcap", "two.mcap"):
        shutil.copy(bag, folder / name)
    (folder / "broken.mcap").write_text("no bag")
    (folder / "notes.txt").write_text("spring")
    return folder


def command(bags, *more):
    return ["replay", str(bags), "-o", str(bags.parent / "out"), *more]


def test_every_bag_is_replayed_once(bags, tmp_path, capsys):
    """One that cannot be read is a row with the reason; what is finished is done again only with other settings."""
    assert cli.main(command(bags)) == 1
    printed = capsys.readouterr().out
    assert "3 bags, 0 of them finished" in printed and "2 of 3: one.mcap: done" in printed
    out = tmp_path / "out"
    page = (out / "replay.html").read_text()
    assert page.count("<tr>") == 1 + 3 and 'href="two.mcap/report.html"' in page and "broken.mcap" in page
    assert 'class="worse">broken.mcap: bag ' in page
    figures = json.loads((out / "one.mcap" / "figures.json").read_text())
    assert figures["counts"]["draped"] == 12 and (out / "one.mcap" / "clouds").is_dir()
    assert f"{figures['figures']['edge_strain_percent']['mean']:.3f}" in page
    (bags / "broken.mcap").unlink()
    written = (out / "one.mcap" / "figures.json").stat().st_mtime_ns
    assert cli.main(command(bags)) == 0
    assert "2 bags, 2 of them finished" in capsys.readouterr().out
    assert (out / "one.mcap" / "figures.json").stat().st_mtime_ns == written
    shutil.copy(bags / "one.mcap", bags / "two.mcap")
    assert cli.main(command(bags)) == 0
    assert "2 bags, 1 of them finished" in capsys.readouterr().out, "its file is a newer one"
    assert cli.main(command(bags, "--fit", "0")) == 0
    assert "2 bags, 0 of them finished" in capsys.readouterr().out
    assert sorted(path.name for path in bags.iterdir()) == ["notes.txt", "one.mcap", "two.mcap"]


def test_what_was_interrupted_goes_on(bags, monkeypatch, capsys):
    """With the bags that are left."""
    (bags / "broken.mcap").unlink()
    with monkeypatch.context() as patch:
        patch.setattr(many_bags, "_overview", lambda *_: signal.raise_signal(signal.SIGINT))  # after the first bag
        assert cli.main(command(bags)) == 130
    assert cli.main(command(bags)) == 0
    assert "2 bags, 1 of them finished" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["{bags}"], "is a folder of bags: give --output FOLDER"),
        (["{bags}", "-o", "{bags}"], "is the folder of the bags itself"),
        (["{bags}", "-o", "{bags}/notes.txt"], "notes.txt is a file; a folder is needed"),
        (["{bags}", "-o", "{tmp}/out", "--json", "{tmp}/x.json"], "--json is for a single bag"),
        (["{bags}", "-o", "{tmp}/out", "--baseline", "{tmp}/x.json"], "--baseline is for a single bag"),
        (["{tmp}/empty", "-o", "{tmp}/out"], "empty is no bag and holds none"),
    ],
)
def test_refusals(arguments, said, bags, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert cli.main(["replay", *(text.format(tmp=tmp_path, bags=bags) for text in arguments)]) == 2
    error = capsys.readouterr().err
    assert said.format(bags=bags) in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
