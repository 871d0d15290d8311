"""The plain C interface: a C program on it gives the Python evaluator's bits; what it refuses, and how."""

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told
from native_library import (
    BAD_ARGUMENT,
    BAD_FILE,
    BAD_POSE,
    INSTALLED,
    NATIVE,
    OK,
    Options,
    c_library,
    load,
    options,
    resealed,
    save_one,
    step,
    step_moving,
)
from random_models import random_avatar, random_model, random_pose
from scipy.spatial.transform import Rotation

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model
from physkin_core.cli import main
from physkin_core.runtime import body_encoder
from physkin_core.runtime.bound_file import save_bound_outfit
from physkin_core.runtime.evaluator import PRECISIONS, supported_instruction_sets

C_FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")


def step_accelerated(c, garment, pose, felt, out):
    return c.physkin_step_accelerated(garment, pose.ctypes.data, felt.ctypes.data, out.ctypes.data, 6, 6)


@pytest.fixture(scope="module")
def c():
    return c_library()


@pytest.fixture
def few_body_points(monkeypatch):
    """The hyper modulator has tests of its own; here a body is 50 points."""
    monkeypatch.setattr(body_encoder, "POINT_COUNT", 50)


def compiled(source, folder):
    program = folder / "program"
    link = ["-L", INSTALLED, "-lphyskin_c", f"-Wl,-rpath,{INSTALLED}"]
    subprocess.run(["cc", *C_FLAGS, "-I", NATIVE / "include", source, "-o", program, *link], check=True)
    return program


def test_the_example_gives_the_python_evaluators_bits(tmp_path):
    """`physkin bind` a shipped garment to the bundled avatar, drape it in C."""
    bound = tmp_path / "tshirt.physkin"
    assert main(["bind", str(BUNDLED_AVATAR), "--garment", "tshirt", "-o", str(bound)]) == 0
    program = compiled(NATIVE / "examples" / "drape.c", tmp_path)
    pose = {"lowerarm01.L_z": "-1.0", "upperarm01.R_x": "0.4"}
    command = [program, bound, *(word for joint in pose.items() for word in joint)]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()

    model = load_garment_model("tshirt")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    expected = draper.drape({joint: float(value) for joint, value in pose.items()})
    for kind, columns in (("v", expected[:, :3]), ("vn", expected[:, 3:])):
        rows = [line.split()[1:] for line in lines if line.split()[0] == kind]
        assert np.array_equal(np.array(rows, dtype=np.float32), columns)
    faces = [line.split()[1:] for line in lines if line.startswith("f ")]
    assert np.array_equal(np.array(faces, dtype=int) - 1, draper.faces)
    broken = subprocess.run([program, program], capture_output=True, text=True)
    assert broken.returncode == 1 and "no bound garment" in broken.stderr
    misspelt = subprocess.run([program, bound, "elbow", "1"], capture_output=True, text=True)
    assert misspelt.returncode == 2 and misspelt.stderr == "no joint elbow\n" and not misspelt.stdout


@pytest.mark.parametrize("level", supported_instruction_sets())
@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_option_gives_the_same_bits(precision, level, c, make_garment, make_pose, tmp_path):
    """From memory at an odd address, into rows at an odd distance."""
    rng = np.random.default_rng(50)
    garment = replace(make_garment(rng), faces=rng.integers(0, 50, size=(90, 3)).astype(np.int32))
    save_one(garment, tmp_path / "g")
    pose, gravity = make_pose(rng, garment)
    frame = NativeFrame([garment], precision=precision, instruction_set=level)
    (expected,) = clouds(frame, [garment], pose, told(gravity))
    how = options(precision.encode(), level.encode())
    status, loaded = load(c, (tmp_path / "g").read_bytes(), how)
    assert status == OK, c.physkin_last_error()
    out = np.full((50, 9), 7, dtype=np.float32)
    assert step(c, loaded, pose, gravity, out, 6, 9) == OK
    assert np.array_equal(out[:, :6], expected) and (out[:, 6:] == 7).all()
    assert step(c, loaded, pose, gravity, out[:, 6:], 3, 9) == OK
    assert np.array_equal(out[:, 6:], expected[:, :3])
    assert (c.physkin_precision(loaded), c.physkin_instruction_set(loaded)) == (precision.encode(), level.encode())
    c.physkin_close(loaded)


def test_what_a_file_says_of_itself(c, small_bound_file):
    """Counts, names, ranges and faces; an index out of range has no name."""
    status, garment = load(c, small_bound_file.read_bytes())
    assert status == OK, c.physkin_last_error()
    counts = [getattr(c, f"physkin_{name}_count")(garment) for name in ("vertex", "joint", "face")]
    assert counts == [50, 7, 90]
    assert [c.physkin_joint_name(garment, k) for k in (0, 6, 7, -1)] == [b"joint 0", b"joint 6", None, None]
    limits = [ctypes.c_float() for _ in range(3)]
    assert c.physkin_joint_range(garment, 3, *map(ctypes.byref, limits)) == OK
    assert limits[0].value < limits[1].value < limits[2].value
    axis = (ctypes.c_float * 3)()
    assert c.physkin_joint_axis(garment, 3, axis) == OK
    assert np.linalg.norm(axis) == pytest.approx(1, abs=1e-6)
    assert c.physkin_joint_axis(garment, -1, axis) == BAD_ARGUMENT
    assert c.physkin_joint_range(garment, 7, *map(ctypes.byref, limits)) == BAD_ARGUMENT
    assert b"must be from 0 to 6" in c.physkin_last_error()
    faces = np.ctypeslib.as_array(c.physkin_faces(garment), shape=(90, 3))
    assert faces.min() >= 0 and faces.max() < 50
    c.physkin_close(garment)
    c.physkin_close(None)


def test_a_program_in_c(small_bound_file, tmp_path):
    """A step allocates nothing, neither when it succeeds nor when it is refused."""
    program = compiled(NATIVE.parent / "tests" / "native" / "c_host" / "c_host_test.c", tmp_path)
    assert subprocess.run([program, small_bound_file], check=True, capture_output=True, text=True).stdout == "0\n"


@pytest.mark.usefixtures("few_body_points")
def test_effective_gravity(c, tmp_path):
    """Python's bits, zero and 9.81 m/s2 among them; what is refused writes nothing."""
    rng = np.random.default_rng(60)
    model = random_model(rng)
    draper, pose = Draper(model, random_avatar(rng, model.rig)), random_pose(rng, model.rig)[0]
    draper.save_bound(tmp_path / "g")
    status, garment = load(c, (tmp_path / "g").read_bytes())
    assert status == OK, c.physkin_last_error()
    out = np.full((draper.vertex_count, 6), 7, dtype=np.float32)
    down = np.float32([0.6, 0.1, -0.79])
    for size in (0.0, 3.0, 9.81, 29.4):
        felt = np.float32(size) * down / np.linalg.norm(down)
        status = step_accelerated(c, garment, pose, felt, out)
        assert status == OK, c.physkin_last_error()
        assert np.array_equal(out, draper.drape(pose, effective_gravity=felt))
    out[:] = 7
    for felt in ([0, 0, -29.5], [np.nan, 0, 0], [0, -np.inf, 0], [3e38, 0, 0]):
        assert step_accelerated(c, garment, pose, np.float32(felt), out) == BAD_POSE
        assert b"effective_gravity must be (3,), finite, up to 29.4 m/s2 long, got (" in c.physkin_last_error()
    assert c.physkin_step_accelerated(garment, pose.ctypes.data, None, out.ctypes.data, 6, 6) == BAD_ARGUMENT
    assert (out == 7).all()
    c.physkin_close(garment)


@pytest.mark.usefixtures("exact_network_weights", "few_body_points")
@pytest.mark.parametrize("network", [False, True])
def test_a_root_that_moves(network, c, tmp_path):
    """As Python's drapes with time and root, for every amount of sway, over a jump, a gap, a stamp that comes again, a
    clock that goes back and a reset."""
    rng = np.random.default_rng(61)
    model = random_model(rng, learnt_sway=network)
    draper, pose = Draper(model, random_avatar(rng, model.rig)), random_pose(rng, model.rig)[0]
    draper.save_bound(tmp_path / "g")
    garment, hanging = (load(c, (tmp_path / "g").read_bytes())[1] for _ in range(2))
    out, plain = (np.full((draper.vertex_count, 6), 7, dtype=np.float32) for _ in range(2))
    largest = 0.0
    for k in range(60):
        at = k - (k in (8, 45))
        time = at / 60 + (k > 40) - 5 * (k > 54)
        turn = Rotation.from_euler("ZY", (0.001 * at * at, 0.02 * at)).as_quat()
        root = np.array([0.002 * at * at + 5 * (k > 30), 0.0, 0.9, *turn])
        draper.sway = (1.0, 0.4, 0.0)[k // 20]
        assert c.physkin_set_sway(garment, draper.sway) == OK
        if k == 50:
            draper.reset()
            assert c.physkin_reset(garment) == OK
        pose = (0.98 * pose).astype(np.float32)
        assert step_moving(c, garment, pose, time, root, out) == OK, c.physkin_last_error()
        assert np.allclose(out, draper.drape(pose, time=time, root=root), atol=1e-5)
        down = Rotation.from_quat(turn).inv().apply([0, 0, -1]).astype(np.float32)
        assert step(c, hanging, pose, down, plain) == OK
        assert draper.sway > 0 or np.allclose(out, plain, atol=1e-5)
        largest = max(largest, np.abs(out - plain).max())
    assert (largest > 0.01) == network, "it sways by its network, and only by that"
    for each in (garment, hanging):
        c.physkin_close(each)


@pytest.mark.usefixtures("exact_network_weights", "few_body_points")
def test_wind(c, tmp_path):
    """As Python's drapes in the same wind, of roots at rest and in motion; what cannot blow is refused."""
    rng = np.random.default_rng(62)
    model = random_model(rng, learnt_sway=True)
    draper, pose = Draper(model, random_avatar(rng, model.rig)), random_pose(rng, model.rig)[0]
    draper.save_bound(tmp_path / "g")
    _, garment = load(c, (tmp_path / "g").read_bytes())
    out, still = np.empty((2, draper.vertex_count, 6), dtype=np.float32)
    down = np.float32([0.6, 0.0, -0.8])
    assert step(c, garment, pose, down, still) == OK
    for k, wind in enumerate(([3.0, 0.0, 0.0], [3.0, -2.0, 1.0], [-8.0, 0.0, 0.0])):
        draper.wind = wind
        assert c.physkin_set_wind(garment, np.array(wind).ctypes.data) == OK
        root = np.array([0.1 * k, 0, 0.9, *Rotation.from_euler("z", 0.1 * k).as_quat()])
        assert step_moving(c, garment, pose, k / 60, root, out) == OK
        assert np.allclose(out, draper.drape(pose, time=k / 60, root=root), atol=1e-5)
    for wrong, said in (
        ([0, 14, 0], b"got (0, 14, 0)"),
        ([np.nan, 0, 0], b"up to 13 m/s"),
        ([0, 0, np.inf], b"finite"),
    ):
        assert c.physkin_set_wind(garment, np.array(wrong, dtype=np.float64).ctypes.data) == BAD_ARGUMENT
        assert said in c.physkin_last_error()
    assert c.physkin_set_wind(garment, None) == c.physkin_set_wind(None, root.ctypes.data) == BAD_ARGUMENT
    assert step(c, garment, pose, down, out) == OK
    assert np.allclose(out, draper.drape(pose, down), atol=1e-5) and np.abs(out - still).max() > 1e-3
    c.physkin_close(garment)


def test_a_step_without_a_time_ends_what_was_before(c, small_bound_file):
    """The next one with a root is a first one."""
    moved, fresh = (load(c, small_bound_file.read_bytes())[1] for _ in range(2))
    pose, down = np.zeros(7, np.float32), np.float32([0, 0, -1])
    clouds = [np.empty((50, 6), np.float32) for _ in range(3)]
    for k in range(6):
        root = [0.01 * k * k, 0, 0.9, 0, 0, 0, 1]
        assert step_moving(c, moved, pose, k / 60, root, clouds[0]) == OK
    assert step(c, moved, pose, down, clouds[1]) == OK
    assert np.abs(clouds[0] - clouds[1]).max() > 1e-3
    for garment, cloud in ((moved, clouds[1]), (fresh, clouds[2])):
        assert step_moving(c, garment, pose, 0.1, root, cloud) == OK
        c.physkin_close(garment)
    assert np.array_equal(clouds[1], clouds[2])


def test_bad_roots_write_nothing_and_say_why(c, small_bound_file):
    _, garment = load(c, small_bound_file.read_bytes())
    pose, out = np.zeros(7, np.float32), np.full((50, 6), 7, dtype=np.float32)
    still = [0.0] * 6 + [1.0]
    for time, root, message in (
        (np.nan, still, b"finite"),
        (0.0, [np.inf, *still[1:]], b"finite"),
        (0.0, [0.0] * 7, b"length 1"),
        (0.0, [1e10, *still[1:]], b"within"),
    ):
        assert step_moving(c, garment, pose, time, root, out) == BAD_POSE
        assert message in c.physkin_last_error()
    assert c.physkin_step_moving(garment, pose.ctypes.data, 0.0, None, out.ctypes.data, 6, 6) == BAD_ARGUMENT
    for amount in (-0.1, 1.1, np.nan):
        assert c.physkin_set_sway(garment, amount) == BAD_ARGUMENT
        assert b"from 0 to 1" in c.physkin_last_error()
    assert c.physkin_set_sway(None, 1.0) == c.physkin_reset(None) == BAD_ARGUMENT
    assert (out == 7).all()
    c.physkin_close(garment)


def test_bad_steps_write_nothing_and_say_why(c, small_bound_file):
    _, garment = load(c, small_bound_file.read_bytes())
    pose, gravity = np.zeros(7, np.float32), np.array([0, 0, -1], np.float32)
    out = np.full((50, 6), 7, dtype=np.float32)
    assert c.physkin_step(garment, None, gravity.ctypes.data, out.ctypes.data, 6, 6) == BAD_ARGUMENT
    for columns, stride, message in ((4, 6, b"columns is 4"), (6, 5, b"stride is 5"), (3, -3, b"stride is -3")):
        assert step(c, garment, pose, gravity, out, columns, stride) == BAD_ARGUMENT
        assert message in c.physkin_last_error()
    for wrong in ((0, 0, -9.81), (0, 0, 0), (0, np.nan, -1)):
        assert step(c, garment, pose, np.float32(wrong), out) == BAD_POSE
        assert c.physkin_last_error().startswith(b"gravity must be a unit direction (3,), got (0, ")
    pose[2] = np.inf
    assert step(c, garment, pose, gravity, out) == BAD_POSE
    assert c.physkin_last_error().startswith(b"joint_positions[2] is inf")
    assert (out == 7).all()
    c.physkin_close(garment)


@pytest.mark.parametrize(
    "how, message",
    [
        (options(precision=b"fp8"), b"'fp8' is unknown"),
        (options(instruction_set=b"avx"), b"'avx' is unknown"),
        (Options(3), b"options.size is 3"),
    ],
)
def test_bad_options_are_refused(how, message, c, small_bound_file):
    status, garment = load(c, small_bound_file.read_bytes(), how)
    assert (status, garment.value) == (BAD_ARGUMENT, None)
    assert message in c.physkin_last_error()


def refusal(c, data) -> str:
    """What is said of a file that is refused."""
    status, garment = load(c, data)
    assert (status, garment.value) == (BAD_FILE, None)
    assert len(c.physkin_last_error()) <= 300
    return c.physkin_last_error().decode()


def test_files_that_are_cut_off_or_changed_are_refused(c, small_bound_file):
    """At any byte, by the checksum; where that fits again, what a file is cut off within is named."""
    data = small_bound_file.read_bytes()
    for size in [*range(2000), *range(2000, len(data), 23)]:
        anew = "no bound garment" if size < 16 else "cut off or damaged: its checksum does not match"
        assert anew in refusal(c, data[:size])
    for size in range(16, len(data), 31):
        assert "the file ends within" in refusal(c, resealed(data[:size]))
    for at in range(0, len(data), 23):
        refusal(c, data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    assert "goes on behind its last array" in refusal(c, resealed(data + b"\0"))
    loaded = 0
    for at in range(16, len(data) - 4, 97):  # some bytes are of numbers, which may have other values
        status, garment = load(c, resealed(data[:at] + bytes(4) + data[at + 4 :]))
        assert status in (OK, BAD_FILE) and len(c.physkin_last_error()) <= 300
        loaded += status == OK
        c.physkin_close(garment)
    assert loaded > 10


def number(value: int) -> bytes:
    return value.to_bytes(4, "little")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: b"safetens" + d[8:], "bytes is no bound garment, or was bound by another version"),
        (lambda d: d[:8] + number(9) + d[12:], "the file has version 9; this library reads 14; `physkin bind` it anew"),
        (lambda d: d[:20] + number(6) + d[24:90] + d[101:], "names 6 joints; expected 7"),
        (lambda d: d[:101] + number(0) + d[105:], "0 for the number of garments; allowed: 1 to 16"),
        (lambda d: d[:101] + number(17) + d[105:], "17 for the number of garments"),
        (lambda d: d[:110] + number(2) + d[114:126] + number(0) + d[126:], "names 2 fabrics of garment 0; expected 1"),
        (lambda d: d[:126] + number(3) + d[130:], "3 for the kind of bone_parents of garment 0; allowed: 0 to 2"),
        (lambda d: d[:126] + number(0) + d[130:], "bone_parents of garment 0 are not integers"),
        (lambda d: d[:130] + number(2**24 + 1) + d[134:], "16777217 for a size of bone_parents"),
        (lambda d: d[:130] + number(2**24) + d[134:], "the file ends within bone_parents of garment 0"),
        (lambda d: d[:-4] + number(257), "257 for the number of orders; allowed: 0 to 256"),
    ],
)
def test_other_files_are_refused(change, message, c, bare_file):
    """In one short sentence, by what stands where: joints from byte 20, garments from 101, fabrics from 110, the first
    array from 126; nothing of such a file is used."""
    assert message in refusal(c, resealed(change(bare_file(lambda garment: {}))))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda g: {"normals": g.normals[:49]}, "49 for a size of normals of garment 0; allowed: 50 to 50"),
        (lambda g: {"bone_heads": np.nan * g.bone_heads}, "bone_heads[0] is nan"),
        (lambda g: {"pose_layers": g.pose_layers * 30}, "90 for the number of pose_layers of garment 0"),
    ],
)
def test_other_garments_are_refused(change, message, c, bare_file):
    """As `test_native_boundary` has it for all that Python hands over."""
    assert message in refusal(c, bare_file(change))


@pytest.fixture
def bare_file(make_garment, tmp_path):
    """The bytes of a small file, some fields of its garment changed."""

    def write(change):
        garment = make_garment(np.random.default_rng(53))
        save_one(replace(garment, **change(garment)), tmp_path / "g")
        return (tmp_path / "g").read_bytes()

    return write


@pytest.mark.slow
def test_files_without_an_end(c):
    """What never ends is read up to what a garment may have."""
    garment = ctypes.c_void_p()
    assert c.physkin_open(b"/dev/zero", None, ctypes.byref(garment)) == BAD_FILE
    assert c.physkin_last_error() == b"the file has more than 536870912 bytes, which is all that are read"


def test_files_that_cannot_be_read(c, tmp_path):
    garment = ctypes.c_void_p()
    for path in (tmp_path / "none", tmp_path):
        assert c.physkin_open(str(path).encode(), None, ctypes.byref(garment)) == BAD_FILE
        assert garment.value is None
    assert c.physkin_open(None, None, ctypes.byref(garment)) == BAD_ARGUMENT


def test_joint_names_may_hold_any_text(c, make_garment, tmp_path):
    """Quotes, controls, and letters of every length in UTF-8."""
    names = ["a", 'quote " and \\', "line\nend", "ä", "肩", "🦴", "\x7f"]
    garment = make_garment(np.random.default_rng(51))
    save_one(garment, tmp_path / "g", joint_names=names)
    status, loaded = load(c, (tmp_path / "g").read_bytes())
    assert status == OK, c.physkin_last_error()
    assert [c.physkin_joint_name(loaded, k).decode() for k in range(7)] == names
    c.physkin_close(loaded)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"joint_names": ["a"]}, "1 joint names for 7 degrees of freedom"),
        ({"names": []}, "0 names for 1 garments"),
        ({"fabrics": [["a", "b"]]}, "2 names for 1 fabrics"),
    ],
)
def test_too_few_names_are_refused(given, message, make_garment, tmp_path):
    wanted = {"names": ["g"], "joint_names": list("abcdefg"), "fabrics": [["as bound"]]}
    with pytest.raises(ValueError, match=message):
        save_bound_outfit([make_garment(np.random.default_rng(52))], tmp_path / "h", **wanted | given)
    assert not (tmp_path / "h").exists()
