"""`physkin drape-many` on a Ray cluster of two machines, one of which is lost: same bytes, nothing done twice."""

from __future__ import annotations

import importlib.util
import json
import shutil
import signal
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main
from physkin_core.cluster import cluster as ray_cluster
from physkin_core.cluster.cluster import UNFINISHED, FolderRow, do_folder_rows
from physkin_core.cluster.drape_many import KEPT, _drape, command_parser, read_table, rows_of
from physkin_core.extras import install_command
from physkin_core.motion.loading import save_motion

if any(
    importlib.util.find_spec(name) is None for name in ("ray", "zarr")
):  # not imported: what Ray prints is set later
    pytest.skip("needs the [cluster] extra", allow_module_level=True)

CLIPS = 8


@pytest.fixture(scope="module")
def machines():
    """A cluster, and that of its two machines of a core each that may be lost."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        from ray.cluster_utils import Cluster

        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        second = cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        yield cluster, second
        cluster.shutdown()


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    """A table of short clips in files, two garments in turn, and a row that cannot be draped."""
    folder = tmp_path_factory.mktemp("jobs")
    lines = ["motion,garment"]
    for k in range(CLIPS):
        save_motion(load_motion("walk").looped(1.1 + 0.05 * k), folder / f"walk{k}.safetensors")
        lines.append(f"{folder / f'walk{k}.safetensors'},{('tshirt', 'trousers')[k % 2]}")
    table = folder / "jobs.csv"
    table.write_text("\n".join([*lines, "nosuch.bvh,tshirt"]) + "\n")
    return table


@pytest.fixture(scope="module")
def at_once(jobs, tmp_path_factory):
    """The folder of results that one process made, row after row."""
    output = tmp_path_factory.mktemp("here")
    options = command_parser().parse_args([str(jobs), "-o", str(output)])
    rows = rows_of(read_table(jobs), options, ".zarr")
    with threadpool_limits(1):  # as workers have it: sums of two threads differ by what is rounded
        assert do_folder_rows(rows, partial(_drape, ".zarr"), output / "page.html", lambda *_: "", here=True) == 1
    return output


def contents(folder: Path) -> dict[str, bytes]:
    """Of all files of results."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("*/**/*") if path.is_file()}


def test_a_lost_machine_changes_no_byte(machines, jobs, at_once, tmp_path, capsys):
    """Two workers, one of which is lost with its machine in the middle of a row; then only what failed is tried."""
    cluster, second = machines
    output = tmp_path / "out"

    def lose():
        until = time.monotonic() + 60
        while len(list((output / UNFINISHED).glob("*"))) < 2 and time.monotonic() < until:  # both are at work
            time.sleep(0.005)
        cluster.remove_node(second, allow_graceful=False)

    hand = threading.Thread(target=lose)
    hand.start()
    command = ["drape-many", str(jobs), "-o", str(output), "--address", cluster.address]
    assert main(command) == 1, "one row fails"
    hand.join()
    assert contents(output) == contents(at_once) and not (output / UNFINISHED).exists()
    notes = [json.loads((output / f"avatar-walk{k}" / "row.json").read_text())["notes"] for k in range(CLIPS)]
    assert [row["frames"] for row in notes[:2]] == [66, 69] and notes[1]["motion"] == str(
        jobs.parent / "walk1.safetensors"
    )
    page = (output / "drape-many.html").read_text()
    assert f"{CLIPS} finished, 1 failed, 0 to do" in page
    assert page.count('class="worse"') == 1 and "motion file nosuch.bvh: no such file" in page
    capsys.readouterr()
    times = {path: path.stat().st_mtime_ns for path in output.glob("*/*")}
    shutil.rmtree(output / "avatar-walk3")
    assert main(command) == 1
    printed = capsys.readouterr().out
    assert f"9 rows, {CLIPS - 1} of them finished" in printed and "2 of 2" in printed
    assert {path: when for path, when in times.items() if path.stat().st_mtime_ns != when}.keys() == {
        output / "avatar-walk3" / name for name in ("row.json", "avatar-walk3.zarr")
    }
    assert contents(output) == contents(at_once)


def test_a_row_that_ends_its_process_takes_no_other_one_with_it(machines, monkeypatch):
    monkeypatch.setattr(ray_cluster, "RETRIES", 0)
    monkeypatch.setattr(ray_cluster, "LONGEST_BATCH", 3)
    numbers = [signal.SIGCHLD, signal.SIGKILL, signal.SIGCHLD]
    rows = [FolderRow(f"{each.name}{k}", each, {}) for k, each in enumerate(2 * numbers)]
    done = ray_cluster.done_on_cluster(lambda row: signal.raise_signal(row.order), rows, address=machines[0].address)
    assert sorted((outcome.row.name, outcome.reason) for outcome in done if outcome) == [
        ("SIGCHLD0", ""),
        ("SIGCHLD2", ""),
        ("SIGCHLD3", ""),
        ("SIGCHLD5", ""),
        ("SIGKILL1", "its worker was lost 1 times"),
        ("SIGKILL4", "its worker was lost 1 times"),
    ]


def test_arrays_are_what_an_outfit_drapes(at_once):
    """With the times and the root of the motion, frame by frame from the first; as readers of Zarr have them."""
    import zarr

    group = zarr.open_group(at_once / "avatar-walk2" / "avatar-walk2.zarr", mode="r")
    motion, model = load_motion("walk").looped(1.2), load_garment_model("tshirt")
    with threadpool_limits(1):
        outfit = Outfit([model], load_avatar(BUNDLED_AVATAR, model.rig))
    assert group.attrs["garments"] == ["tshirt"] and group.attrs["joint_names"] == list(outfit.joint_names)
    shirt, joints = group["tshirt"], group["joint_positions"][:]
    assert shirt["positions"].shape == (72, len(outfit.layers[0].visible), 3), "more than a chunk"
    np.testing.assert_array_equal(shirt["faces"][:], outfit.layers[0].faces)
    np.testing.assert_array_equal(shirt["vertex_ids"][:], outfit.layers[0].visible)
    np.testing.assert_array_equal(group["root"][:], motion.root)
    for frame, (time_now, root) in enumerate(zip(group["time"][:], group["root"][:])):
        (cloud,) = outfit.drape(joints[frame], time=time_now, root=root)
        np.testing.assert_array_equal(shirt["positions"][frame], cloud[:, :3])
        np.testing.assert_array_equal(shirt["normals"][frame], cloud[:, 3:])


@pytest.mark.parametrize(("kind", "worn"), [("zarr", "shorts tshirt"), ("glb", "tanktop"), ("usdc", "tanktop")])
def test_files_have_the_same_bytes_whatever_was_draped_before(kind, worn, tmp_path):
    """A worker keeps the outfit from row to row; layers find each other anew in each."""
    if kind == "usdc":
        pytest.importorskip("pxr", reason="needs the [usd] extra")
    for name in ("one", "two"):
        save_motion(load_motion("kick").looped(0.2), tmp_path / f"{name}.safetensors")
    table = tmp_path / "jobs.jsonl"
    table.write_text(
        "\n".join(f'{{"motion": "{tmp_path / name}.safetensors", "garment": "{worn}"}}' for name in ("one", "two"))
    )
    options = command_parser().parse_args([str(table), "-o", str(tmp_path)])
    rows = rows_of(read_table(table), options, f".{kind}")
    for order in (rows, rows[::-1]):
        KEPT.clear()
        output = tmp_path / f"{order[0].name} first"
        assert do_folder_rows(order, partial(_drape, f".{kind}"), output / "page.html", lambda *_: "", here=True) == 0
    first, last = (contents(tmp_path / f"{row.name} first") for row in rows)
    assert first == last and any(f"avatar-one.{kind}" in name for name in first)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["{jobs}", "--avatars", "bodies"], "--avatars bodies goes with --motions; the table"),
        (["{jobs}", "-o", "{jobs}"], "jobs.csv is a file; a folder is needed"),
        (["nosuch.csv"], "table nosuch.csv: no such file"),
        (["{jobs}", "--address", "127.0.0.1:1"], "--address 127.0.0.1:1: no Ray cluster answers there"),
    ],
)
def test_refusals(arguments, said, jobs, tmp_path, capsys):
    given = [argument.format(jobs=jobs) for argument in arguments]
    assert main(["drape-many", "-o", str(tmp_path / "out"), *given]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_without_ray_the_extra_is_named(jobs, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    assert main(["drape-many", str(jobs), "-o", str(tmp_path)]) == 2
    assert install_command("cluster") in capsys.readouterr().err
