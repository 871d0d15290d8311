"""Rows of `physkin drape-many`: tables, crossed folders, and what is refused, without Ray."""

from __future__ import annotations

import json

import pytest

from physkin_core.cluster.drape_many import JobsError, command_parser, crossed, read_table, rows_of


def rows_in(table, *arguments):
    """By name."""
    options = command_parser().parse_args(["-o", "out", "jobs.csv", *arguments])
    return {row.name: row for row in rows_of(table, options, ".zarr")}


@pytest.fixture
def written(tmp_path):
    def write(text, name="jobs.csv"):
        path = tmp_path / name
        path.write_text(text)
        return read_table(path)

    return write


def test_a_row_for_each_line_of_a_table(written):
    """What a cell does not say, the command line does."""
    rows = rows_in(
        written(
            "motion,name,garment,sway,separate-limbs,wind\nwalk,,,,,\nrun,two,trousers tshirt:denim,0.5,false,1 0 0\n"
        ),
        *("-g", "skirt", "--rate", "30"),
    )
    assert list(rows) == ["avatar-walk", "two"]
    walk, two = rows["avatar-walk"].order, rows["two"].order
    assert (walk.motion, walk.garment, walk.sway, walk.rate, walk.separate_limbs) == (
        "walk",
        ["skirt"],
        1.0,
        30.0,
        True,
    )
    assert (two.garment, two.sway, two.separate_limbs) == (["trousers", "tshirt:denim"], 0.5, False)
    assert two.wind == [1.0, 0.0, 0.0]


def test_lines_of_json_have_their_own_types(written):
    lines = [
        {"motion": "walk", "garment": ["my shirt.safetensors"], "fit": 0, "separate-limbs": False},
        {"motion": "run"},
    ]
    rows = rows_in(written("\n".join(map(json.dumps, lines)) + "\n\n", "jobs.jsonl"))
    order = rows["avatar-walk"].order
    assert (order.garment, order.fit, order.separate_limbs) == (["my shirt.safetensors"], 0.0, False)
    assert list(rows) == ["avatar-walk", "avatar-run"]


def test_folders_are_crossed(tmp_path):
    """Every motion on every avatar, those of an avatar one after the other; what belongs to them is no row."""
    for name in (
        "bodies/a.glb",
        "bodies/b.obj",
        "bodies/b.rig.json",
        "clips/x/walk.bvh",
        "clips/run.npz",
        "clips/run.txt",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    (tmp_path / "clips" / "run.bones.json").write_text("{}")
    rows = rows_in(crossed(tmp_path / "bodies", tmp_path / "clips"))
    assert list(rows) == ["a-run", "a-x-walk", "b-run", "b-x-walk"]
    assert rows["a-run"].shares == rows["a-x-walk"].shares != rows["b-run"].shares
    assert list(rows_in(crossed(None, tmp_path / "clips"))) == ["run", "x-walk"]


def test_settings_follow_what_a_result_depends_on(written, tmp_path):
    """Contents of files, also of those beside them, and options; not where files are."""
    clip = tmp_path / "clip.bvh"

    def settings(*arguments):
        from physkin_core.cluster.drape_many import _digest

        _digest.cache_clear()
        (row,) = rows_in(written(f"motion\n{clip}\n"), *arguments).values()
        return json.dumps(row.settings)

    clip.write_text("one")
    first = settings()
    assert settings() == first and settings("--sway", "0") != first
    (tmp_path / "clip.bones.json").write_text("{}")
    assert settings() != first
    (tmp_path / "clip.bones.json").unlink()
    assert settings() == first
    clip.write_text("two")
    assert settings() != first and str(tmp_path) not in first


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "jobs.csv: it has no rows; allowed columns: name, avatar, motion"),
        ("motion\n", "it has no rows"),
        ("motion\nwalk,run\n", "row 1 is no object, or longer than the header"),
        ("motion,colour\nwalk,red\n", "row 1: unknown column 'colour'; allowed: name, avatar"),
        ("motion,avatar\nwalk,\n,me.glb\n", "row 2: it has no motion; give a file or one of cartwheel, "),
        ("motion,sway\nwalk,much\n", "row 1: sway 'much' is not allowed; it is: how much cloth swings"),
        ("motion,wind\nwalk,1 2\n", "row 1: wind '1 2' is not allowed"),
        ("motion,separate-limbs\nwalk,maybe\n", "row 1: separate-limbs 'maybe' is not allowed"),
        ("motion,own-clothes\nwalk,burn\n", "row 1: own-clothes 'burn' is not allowed"),
        ("motion\nwalk\nwalk\n", "row 2: .*row 1 is called 'avatar-walk', too; give each its own in the column name"),
        ("motion,name\nwalk,one\nrun,One\n", "row 2: .*row 1 is called 'One', too"),
        ("motion,name\nwalk,../out\n", "row 1: name '../out' is no folder's; allowed: no slash"),
        ("motion,name\nwalk,.hidden\n", "row 1: name '.hidden' is no folder's"),
    ],
)
def test_tables_that_are_refused(text, said, written):
    with pytest.raises(JobsError, match=said):
        rows_in(written(text))


def test_files_and_folders_that_are_refused(written, tmp_path):
    with pytest.raises(JobsError, match="the extension '.xlsx' is unknown; allowed: .csv, .jsonl"):
        written("", "jobs.xlsx")
    with pytest.raises(JobsError, match="row 1 is no object"):
        written("[1]", "jobs.jsonl")
    with pytest.raises(JobsError, match="table .*nosuch.csv: no such file"):
        read_table(tmp_path / "nosuch.csv")
    with pytest.raises(
        JobsError, match="--motions .*nosuch: no such folder, or no such files in it; allowed: .safetens"
    ):
        list(crossed(None, tmp_path / "nosuch"))
    (tmp_path / "walk.bvh").write_text("")
    (tmp_path / "empty").mkdir()
    with pytest.raises(JobsError, match="--avatars .*empty: .*allowed: .glb, "):
        list(crossed(tmp_path / "empty", tmp_path))
