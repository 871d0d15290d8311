"""`physkin render`: films read back by their own libraries, the camera, and what is refused before drawing begins."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import load_motion
from physkin_core.cli import main
from physkin_core.extras import install_command
from physkin_core.render import filming
from physkin_core.render.film_files import check_film, write_film
from physkin_core.render.filming import Camera, film

SIZE = (32, 40)


def pictures(count):
    """Plain ones, each of its own grey: (h, w, 3)."""
    return [np.full((SIZE[1], SIZE[0], 3), 40 * k + 20, dtype=np.uint8) for k in range(count)]


def test_mp4_reads_back(tmp_path):
    """As many frames as were given, at the rate, in their greys."""
    av = pytest.importorskip("av")
    (path,) = write_film(tmp_path / "a.mp4", iter(pictures(5)), 12.5)
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        greys = [frame.to_ndarray(format="rgb24").mean() for frame in file.decode(video=0)]
        assert (stream.width, stream.height) == SIZE and float(stream.average_rate) == 12.5
    np.testing.assert_allclose(greys, [20, 60, 100, 140, 180], atol=3)


@pytest.mark.parametrize(("name", "durations"), [("a.gif", [30, 40, 30, 30, 40]), ("a.webp", [33, 34, 33, 33, 34])])
def test_animations_loop_at_their_rate(name, durations, tmp_path):
    """Formats count in 10 or 1 ms; what is rounded is made up for later."""
    image_module = pytest.importorskip("PIL.Image")
    (path,) = write_film(tmp_path / name, iter(pictures(5)), 30.0)
    with image_module.open(path) as file:
        assert file.n_frames == 5 and file.info["loop"] == 0
        found = []
        for frame in range(5):
            file.seek(frame)
            file.load()
            found.append(file.info["duration"])
    assert found == durations


def test_png_is_numbered(tmp_path):
    image_module = pytest.importorskip("PIL.Image")
    given = pictures(2)
    files = write_film(tmp_path / "a.png", iter(given), 30.0)
    assert [path.name for path in files] == ["a_0000.png", "a_0001.png"]
    for path, picture in zip(files, given, strict=True):
        np.testing.assert_array_equal(np.asarray(image_module.open(path)), picture)


@pytest.fixture(scope="module")
def outfit(worn):
    return worn("skirt")


@pytest.mark.parametrize("follow", [True, False])
def test_camera_takes_everything_from_one_distance(follow, outfit, monkeypatch):
    """The box filmed has one size, holds each frame's cloth and body as they are in the world, swaying, and, following,
    goes with the root."""
    motion = load_motion("run").resampled(8.0)
    taken = []
    monkeypatch.setattr(filming, "render", lambda meshes, **options: taken.append((meshes, options)))
    shares = []
    assert len(list(film(outfit, motion, Camera(follow=follow), watch=shares.append))) == motion.frame_count
    assert shares[0] == 0 and shares[-1] == 1
    boxes = np.array([options["bounds"] for _, options in taken])
    np.testing.assert_allclose(np.ptp(boxes, axis=1), np.ptp(boxes[:1], axis=1).repeat(len(boxes), axis=0), atol=1e-9)
    walked = (motion.root_position - motion.root_position[0])[:, :2] if follow else 0
    np.testing.assert_allclose(boxes[:, 0, :2] - boxes[0, 0, :2], walked + np.zeros((len(boxes), 2)), atol=1e-6)
    lowest = min(mesh.vertices[:, 2].min() for meshes, _ in taken for mesh in meshes)
    positions = motion.positions_for(outfit.rig)
    outfit.reset()
    for frame, (meshes, options) in enumerate(taken):
        points = np.concatenate([mesh.vertices for mesh in meshes])
        assert (points >= options["bounds"][0] - 1e-9).all() and (points <= options["bounds"][1] + 1e-9).all()
        assert options["floor"] == pytest.approx(lowest)
        draped = outfit.drape(positions[frame], time=motion.times[frame], root=motion.root[frame])[0][:, :3]
        turn = Rotation.from_quat(motion.root_orientation[frame])
        np.testing.assert_allclose(meshes[1].vertices, turn.apply(draped) + motion.root_position[frame], atol=1e-6)


def test_command_films_an_outfit(tmp_path, capsys):
    """Two small pictures: cloth in the colours of its layers, and another pose in each."""
    pytest.importorskip("mitsuba")
    image_module = pytest.importorskip("PIL.Image")
    arguments = ["render", "run", "-g", "trousers", "-g", "tshirt", "--rate", "1", "--size", "32x40", "--samples", "1"]
    assert main([*arguments, "-o", str(tmp_path / "a.png")]) == 0
    assert "a_0000.png to a_0001.png: 2 frames at 1 Hz" in capsys.readouterr().out
    first, second = (np.asarray(image_module.open(tmp_path / f"a_000{k}.png")).astype(int) for k in (0, 1))
    for picture in (first, second):
        assert picture.shape == (40, 32, 3)
        assert (picture[..., 0] - picture[..., 2] > 80).any(), "no shirt"
    assert np.abs(first - second).max() > 30


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "a.avi"], r"cannot write a.avi: allowed are .mp4, .gif, .webp, .png"),
        (["--size", "31x40", "-o", "a.mp4"], "even width and height, got 31x40"),
        (["--size", "31", "-o", "a.gif"], "--size is '31'; allowed: width and height"),
        (["--size", "9000x40", "-o", "a.gif"], "at most 4096 pixels a side"),
        (["--rate", "60", "-o", "a.gif"], "at most 50 frames a second, got 60"),
        (["--rate", "0", "-o", "a.gif"], "rate"),
        (["--azimuth", "nan", "-o", "a.gif"], "--azimuth is nan; allowed: a finite number"),
        (["--samples", "0", "-o", "a.gif"], "--samples is 0; allowed: 1 to 1024"),
        (["-o", "/nowhere/a.gif"], "there is no folder /nowhere"),
    ],
)
def test_what_cannot_be_filmed(options, message, capsys, monkeypatch):
    """One sentence, before anything is draped."""
    monkeypatch.setattr("physkin_core.render.render.dressed", None)
    assert main(["render", "run", *options]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_missing_encoder_is_told_before_drawing(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ModuleNotFoundError):
        check_film(Path("a.mp4"), size=(2, 2), rate_hz=30.0)
    assert main(["render", "run", "-o", "a.mp4"]) == 2
    assert install_command("view") in capsys.readouterr().err
