"""Figures of a replayed bag: baselines, and the page."""

from __future__ import annotations

import copy
import hashlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")

from bag_messages import gravity, joint_state, recorded  # noqa: E402

from physkin_core import cli  # noqa: E402
from physkin_core.motion.bag_reader import GRAVITY, JOINT_STATE  # noqa: E402
from physkin_core.pictures.picture import PictureError  # noqa: E402
from physkin_ros.messages.conversions import read_cloud  # noqa: E402
from physkin_ros.replay import report  # noqa: E402
from physkin_ros.replay.bags import BagWriter  # noqa: E402
from physkin_ros.replay.figures import TOLERANCES, BaselineError, load_baseline, regressions, summary  # noqa: E402


def test_a_run_is_compared_with_an_earlier_one(quick, leaning_model_path, bag, tmp_path, capsys):
    """Exit status 1 where a figure is worse, and which it is; the report says so, too."""
    old, page, output = tmp_path / "old.json", tmp_path / "page.html", tmp_path / "out"
    arguments = ["replay", str(bag), "-g", str(leaning_model_path)]
    assert cli.main([*arguments, "--json", str(old), "-o", str(output)]) == 0
    figures = json.loads(old.read_text())
    clouds = np.stack([read_cloud(message) for _, _, message in recorded(output)])
    assert figures["clouds_sha256"] == hashlib.sha256(clouds.tobytes()).hexdigest()
    again = [*arguments, "--baseline", str(old), "--report", str(page)]
    assert cli.main(again) == 0
    assert "not worse than" in capsys.readouterr().out and "Not worse than the baseline" in page.read_text()
    figures["figures"]["edge_strain_percent"]["mean"] /= 2
    old.write_text(json.dumps(figures))
    assert cli.main(again) == 1
    assert "edge_strain_percent mean is" in capsys.readouterr().err and "Worse than the baseline" in page.read_text()


def test_each_figure_may_grow_so_far_and_no_further(figures):
    """What the table of tolerances states is what fails; of rejected messages not one more."""
    assert not regressions(figures, figures)
    for (name, kind), (share, margin) in TOLERANCES.items():
        old, new = copy.deepcopy(figures), copy.deepcopy(figures)
        value = figures["figures"][name][kind]
        old["figures"][name][kind] = (value - margin) / (1 + share) + 1e-9
        assert not regressions(figures, old)
        old["figures"][name][kind] -= 1e-6 + 1e-6 * value
        (line,) = regressions(figures, old)
        assert line.startswith(f"{name} {kind} is ")
        new["figures"][name][kind] = None
        assert any("is missing" in line for line in regressions(new, old))
    new = copy.deepcopy(figures)
    new["counts"]["rejected"] = 1
    assert regressions(new, figures) == ["rejected is 1; it was 0, allowed is 0"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda old: old["bag"].update(sha256="0"), "its bag sha256 is 0"),
        (lambda old: old["run"].update(contact_every=7), "its run contact_every is 7, this one's is 4"),
        (lambda old: old["figures"]["jitter_mm"].update(mean="much"), "figures jitter_mm mean is 'much'|is 'much'"),
    ],
)
def test_baselines_that_do_not_fit_are_refused(change, reason, figures):
    """Another recording says nothing about this one."""
    old = copy.deepcopy(figures)
    change(old)
    with pytest.raises(BaselineError, match=reason):
        regressions(figures, old)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 2}', '{"schema": 1, "bag": 3}'])
def test_broken_baselines_are_refused(text, tmp_path):
    """Before anything is draped."""
    path = tmp_path / "old.json"
    path.write_text(text)
    with pytest.raises(BaselineError, match="baseline"):
        load_baseline(path)


def test_page_stands_alone_and_escapes(figures, tmp_path):
    """One file of bounded size that loads nothing, however long the bag; a joint name cannot smuggle anything in."""
    figures = copy.deepcopy(figures)
    figures["reasons"] = {"joint '<script>' is nan": 3}
    for name in ("edge_strain_percent", "area_strain_percent", "jitter_mm", "jitter_skinning_mm", "latency_us"):
        figures["series"][name] = [None, *np.random.default_rng(1).random(20_000).tolist()]
    figures["series"]["time_s"] = [k / 60 for k in range(20_001)]
    path = tmp_path / "page.html"
    report.write_report(path, figures, [("0.10 <s", b"\x89PNG")], "a <remark", ["edge strain <up>"])
    page = path.read_text()
    assert not re.search(r"<(script|up|remark|s)\b", page) and "&lt;script&gt;" in page and "&lt;up&gt;" in page
    assert "data:image/png;base64,iVBORw==" in page and not re.search(r"(?:src|href)=\"(?!data:)", page)
    assert len(page) < 500_000


@pytest.mark.parametrize("count", [1, 3])
def test_little_is_enough_for_a_page(count, run, draper, tmp_path, monkeypatch):
    """One joint state, or several at one moment, upside down: no rate and no jitter, but figures, plots and scenes."""
    pytest.importorskip("PIL", reason="needs pillow: pip install 'physkin[view]'")
    path, page, scenes = tmp_path / "one.mcap", tmp_path / "page.html", []
    with BagWriter(path) as writer:
        writer.write("/gravity", GRAVITY, gravity(0, 0, 1), 7)
        for _ in range(count):
            writer.write("/joint_states", JOINT_STATE, joint_state(draper.joint_names, draper.model.rig.rest), 7)
    found, figures = run(path, contact_every=count)
    assert figures["counts"]["draped"] == count and figures["figures"]["jitter_mm"]["mean"] is None
    assert figures["bag"]["rate_hz"] is None
    report.write_report(page, json.loads(json.dumps(figures, allow_nan=False)))
    assert "</table>" in page.read_text() and summary(figures)
    blank = np.zeros((4, 4, 3), dtype=np.uint8)
    monkeypatch.setattr(report, "render", lambda meshes, **_: scenes.append(meshes) or blank)
    report.thumbnails(found, draper)
    body = scenes[0][0].vertices
    assert body[body[:, 2].argmax()] @ [0, 0, 1] == pytest.approx(-draper.avatar.vertices[:, 2].min(), abs=1e-3)


def test_missing_pictures_are_explained(found_and_figures, draper, tmp_path, monkeypatch):
    """Without the extra `[view]` the page goes without them and without plots, and says what to install."""
    why = PictureError("pictures need mitsuba")
    monkeypatch.setattr(report, "render", lambda *_, **__: (_ for _ in ()).throw(why))
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    found, figures = found_and_figures
    report.write_report(tmp_path / "page.html", figures, *report.thumbnails(found, draper))
    page = (tmp_path / "page.html").read_text()
    assert "pictures need mitsuba" in page and "plots: they need matplotlib" in page and "<img" not in page


def test_pictures_in_the_page(found_and_figures, draper, tmp_path, monkeypatch):
    """Clouds that were measured, and the plots, as PNG."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    monkeypatch.setattr(report, "PICTURE_SIZE", (24, 32))
    monkeypatch.setattr(report, "PICTURES", 2)
    found, figures = found_and_figures
    pictures, remark = report.thumbnails(found, draper)
    assert [caption for caption, _ in pictures] == ["0.00 s", "0.13 s"] and not remark
    report.write_report(tmp_path / "page.html", figures, pictures)
    assert (tmp_path / "page.html").read_text().count('<img src="data:image/png;base64,iVBORw0KGgo') == 3


def test_every_key_is_explained(figures):
    """docs/replay.md knows what --json writes."""
    text = (Path(__file__).parents[3] / "docs" / "replay.md").read_text()
    named = set(re.findall(r"`(?:\w+\.)*(\w+)`", text))
    keys = set(figures)
    for section in ("bag", "run", "counts", "figures", "series"):
        keys |= set(figures[section])
    keys |= set(figures["figures"]["jitter_mm"])
    assert keys - named == set()
