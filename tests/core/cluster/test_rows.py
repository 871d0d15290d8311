"""Rows one after the other in this process: what is said while they run, and what is left when they are stopped."""

from __future__ import annotations

import signal

import pytest

from physkin_core.cluster.cluster import FolderRow, do_folder_rows, do_rows

ROWS = [FolderRow(name, name, {"is": name}) for name in ("one", "two", "three")]


def test_a_page_is_read_again_while_there_is_more_to_come(tmp_path, capsys):
    """A row that fails has its reason, the others go on; what has begun is no folder of a row."""
    page, seen = tmp_path / "out" / "page.html", []

    def work(row, folder):
        seen.append(page.read_text() if page.exists() else "")
        (folder / "file").write_text(row.name)
        if row.name == "two":
            raise ValueError("5 < 6")
        return {"length": len(row.name)}

    bodies = []
    body = lambda outcomes, refresh: bodies.append((dict(outcomes), refresh)) or "<b>all</b>"  # noqa: E731
    assert do_folder_rows(ROWS, work, page, body, here=True) == 1
    assert seen[0] == "" and "1 finished, 0 failed, 2 to do" in seen[1] and 'content="15"' in seen[1]
    written = page.read_text()
    assert "2 finished, 1 failed, 0 to do" in written and "two: 5 &lt; 6" in written and "<b>all</b>" in written
    assert "refresh" not in written and bodies[-1][1] == 0 and bodies[-1][0]["three"].result == {"length": 5}
    assert sorted(path.name for path in page.parent.iterdir()) == ["one", "page.html", "three"]
    assert "2 of 3: two: 5 < 6" in capsys.readouterr().out
    assert do_folder_rows(ROWS, work, page, body, here=True) == 1
    assert "3 rows, 2 of them finished" in capsys.readouterr().out and len(seen) == 4


def test_what_is_stopped_goes_on(tmp_path, capsys):
    page, done = tmp_path / "page.html", []

    def work(row, folder):
        if row.name == "two" and not done.count("two"):
            done.append("two")
            signal.raise_signal(signal.SIGINT)
        done.append(row.name)
        return {}

    with pytest.raises(KeyboardInterrupt):
        do_folder_rows(ROWS, work, page, lambda *_: "", here=True)
    assert "stopped; the same command goes on" in capsys.readouterr().out and "1 finished" in page.read_text()
    assert do_folder_rows(ROWS, work, page, lambda *_: "", here=True) == 0
    assert done == ["one", "two", "two", "three"] and (tmp_path / "two").is_dir()


def test_what_results_are_said_to_be(tmp_path, capsys):
    do_rows(ROWS[:1], lambda row: 7, lambda row: None, tmp_path / "page.html", lambda *_: "", say=str, here=True)
    assert "1 of 1: one: 7" in capsys.readouterr().out


def test_errors_of_ours_speak_for_themselves(tmp_path, capsys):
    """Others are named, as a message such as 'key' alone says little."""
    from physkin_core.pictures.picture import PictureError

    errors = iter([PictureError("no display"), KeyError("x")])

    def work(row):
        raise next(errors)

    assert do_rows(ROWS[:2], work, lambda row: None, tmp_path / "page.html", lambda *_: "", here=True) == 1
    assert "one: no display" in (said := capsys.readouterr().out) and "two: KeyError: 'x'" in said
