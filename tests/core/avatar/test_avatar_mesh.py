"""OBJ, PLY and STL avatars: with bones and skinning weights, with bones alone, with nothing."""

import json
import logging

import numpy as np
import pytest
import trimesh
from gltf_person import BODY, PERSON, RIG, dense_weights, distances, rig_json, t_posed_body

from physkin_core.avatar import rig_fitting
from physkin_core.avatar.avatar import AvatarError, AvatarWarning
from physkin_core.avatar.loading import load_avatar
from physkin_core.avatar.mesh_avatar import _upright_axis
from physkin_core.formats.gltf_builder import GltfBuilder, write_glb
from physkin_core.rig.rig import Rig

T_VERTICES, T_HEADS, T_TAILS = t_posed_body(BODY, BODY.held_out_bodies[0])
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, where it is not what is tested
AWAY = np.array([0.3, -0.2, 1.0])


def _write_obj(path, vertices, faces, *, textured=False):
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in vertices]
    if textured:  # two groups, a material, and texture corners that no vertex shares
        lines += ["mtllib none.mtl", "vt 0 0", "vt 1 0", "vt 0 1", "o body"]
        half = len(faces) // 2
        for name, part in (("upper", faces[:half]), ("lower", faces[half:])):
            lines += [f"g {name}", f"usemtl {name}"]
            lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in part]
    else:
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def _write_person(path, rig_data=None, vertices=T_VERTICES + AWAY, **options):
    _write_obj(path, vertices, PERSON.faces, **options)
    if rig_data is not None:
        path.with_name(f"{path.stem}.rig.json").write_text(json.dumps(rig_data))
    return path


@pytest.mark.parametrize("textured", [False, True])
def test_obj_with_bones_and_weights(tmp_path, textured):
    """A T-posed OBJ with a full rig file is the A-posed person; texture seams and groups keep the vertex order."""
    path = _write_person(tmp_path / "person.obj", rig_json(T_HEADS + AWAY, T_TAILS + AWAY), textured=textured)
    avatar = load_avatar(path, RIG)
    distance = distances(avatar.vertices, PERSON.vertices)
    assert distance.mean() < 1.5 and distance.max() < 20
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1
    assert distances(avatar.bone_tails, PERSON.bone_tails).max() < 0.1
    assert avatar.warnings == ()


def test_obj_in_centimetres_with_y_up(tmp_path):
    """Axes and unit come from the rig file, which is given explicitly here."""
    to_file = 100 * np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # root frame -> x left, y up, z forward
    path = _write_person(tmp_path / "person.obj", vertices=T_VERTICES @ to_file.T)
    rig_file = tmp_path / "elsewhere.json"
    data = rig_json(T_HEADS @ to_file.T, T_TAILS @ to_file.T, up="Y", forward="Z", scale=0.01)
    rig_file.write_text(json.dumps(data))
    avatar = load_avatar(path, RIG, rig_file=rig_file)
    assert distances(avatar.vertices, PERSON.vertices).mean() < 1.5
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1


def test_bones_without_weights(tmp_path):
    """Skinning weights come from the template body, in the mesh's own pose; the warning says so."""
    path = _write_person(tmp_path / "person.obj", rig_json(T_HEADS + AWAY, T_TAILS + AWAY, weights=False))
    avatar = load_avatar(path, RIG)
    distance = distances(avatar.vertices, PERSON.vertices)
    assert distance.mean() < 3
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1
    assert "template body" in avatar.warnings[0]
    assert np.abs(dense_weights(avatar) - dense_weights(PERSON)).sum(axis=1).mean() / 2 < 0.15


@pytest.mark.parametrize("suffix", [".ply", ".stl"])
def test_ply_and_stl(tmp_path, suffix):
    """Both formats read like the OBJ; the triangle soup of an STL is welded again."""
    trimesh.Trimesh(PERSON.vertices, PERSON.faces, process=False).export(tmp_path / f"person{suffix}")
    data = rig_json(PERSON.bone_heads, PERSON.bone_tails, weights=False)
    (tmp_path / "person.rig.json").write_text(json.dumps(data))
    avatar = load_avatar(tmp_path / f"person{suffix}", RIG)
    assert len(avatar.vertices) == len(PERSON.vertices) and len(avatar.faces) == len(PERSON.faces)
    assert np.allclose(
        avatar.vertices[avatar.faces].mean(axis=0), PERSON.vertices[PERSON.faces].mean(axis=0), atol=1e-3
    )


def test_obj_in_inches_with_y_up_and_hair(tmp_path, caplog):
    """Nothing but the mesh in T-pose, as a modelling tool wrote it, hair an object of its own: the rig is fitted. A log
    line says why that takes its time, warnings, kept and issued, what was assumed and how far the fit is off."""
    hair = trimesh.creation.icosphere(3, 0.2)
    hair.apply_translation(T_VERTICES[T_VERTICES[:, 2].argmax()])
    vertices = np.concatenate([T_VERTICES, hair.vertices])[:, [1, 2, 0]] / 0.0254
    path = _write_person(tmp_path / "person.obj", vertices=vertices)
    with path.open("a") as file:
        file.write("o Hair_01\n" + "".join("f {} {} {}\n".format(*(face + 13719)) for face in hair.faces))
    with caplog.at_level(logging.INFO), pytest.warns(AvatarWarning) as issued:
        avatar = load_avatar(path, RIG)
    assert "fitting the body model to a mesh of" in caplog.text
    assert len(avatar.vertices) == len(PERSON.vertices)
    assert distances(avatar.vertices, PERSON.vertices).mean() < 6
    heads = distances(avatar.bone_heads, PERSON.bone_heads)
    assert heads.mean() < 8 and heads.max() < 25
    fitted = "was fitted to the mesh (from T-pose, mean distance"
    for text in ("in inches", "Y is taken to be up, not Z", "do not heed it: 'Hair_01'", fitted):
        assert sum(text in warning for warning in avatar.warnings) == 1
    said = [str(warning.message) for warning in issued if warning.category is AvatarWarning]
    assert len(said) == len(avatar.warnings) and said[0].endswith(avatar.warnings[0])


def test_glb_without_a_skin_facing_backwards(tmp_path):
    """A glTF mesh without skin is fitted, too; Y is up there; a backward one is turned, with a warning."""
    builder = GltfBuilder({})
    position = builder.add_accessor((PERSON.vertices @ np.diag([-1.0, -1.0, 1.0]))[:, [1, 2, 0]].astype(np.float32))
    indices = builder.add_accessor(PERSON.faces.astype(np.uint16).reshape(-1))
    primitive = {"attributes": {"POSITION": position}, "indices": indices}
    builder.document |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}], "scenes": [{"nodes": [0]}]}
    write_glb(tmp_path / "person.glb", builder)
    avatar = load_avatar(tmp_path / "person.glb", RIG)
    assert distances(avatar.vertices, PERSON.vertices).mean() < 6
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 25
    assert "fitted" in avatar.warnings[0] and "faces -X" in avatar.warnings[1]


def test_a_shape_that_is_no_person_is_refused(tmp_path, monkeypatch):
    """The fit's residual is checked, and the error names it."""
    monkeypatch.setattr(rig_fitting, "TRIAL_ITERATIONS", 1)
    monkeypatch.setattr(rig_fitting, "ITERATIONS", 2)
    trimesh.creation.box((0.3, 1.2, 1.7)).export(tmp_path / "box.obj")
    with pytest.raises(
        AvatarError, match=r"no person .* that the body model fits: \d+ mm mean distance, allowed 2[56] mm.* behind -g"
    ):
        load_avatar(tmp_path / "box.obj", RIG)


def test_what_a_mesh_without_weights_needs(tmp_path):
    """A rig that the template body knows, a rig file that is there and a JSON object, and bones for every limb: those
    missing are named, and so are those found."""
    path = _write_person(tmp_path / "person.obj")
    ends = np.array([[0, 0, 0], [0, 0, 0.5], [0, 0, 1]])
    with pytest.raises(AvatarError, match=r"differs from the garment model's \('base', 'arm'\)"):
        load_avatar(path, Rig(("base", "arm"), np.array([-1, 0]), ends[:2], ends[1:], ()))
    hoofed = rig_json(T_HEADS + AWAY, T_TAILS + AWAY, weights=False)
    hoofed["bones"][RIG.bone_index("foot.R")]["name"] = "Head.R"
    lacking = r"no joint for 1 of the 12 rig bones it must have: foot.R; taken: "
    cases = [
        (None, "no such file"),
        ("{", "is not JSON"),
        ("[]", "it must be a JSON"),
        (json.dumps(hoofed), lacking),
    ]
    for text, message in cases:
        if text is not None:
            (tmp_path / "other.json").write_text(text)
        with pytest.raises(AvatarError, match=message):
            load_avatar(path, RIG, rig_file=tmp_path / "other.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 0 1\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 9\n", "a face has corners at vertices that do not exist"),
        ("v 0 0 0\nv nan 0 0\nv 0 0 1\nf 1 2 3\n", "1 vertices are not finite, the first is 1"),
        ("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 2\n", "all faces are degenerate"),
        ("v 0 0 0\nv a b c\nf one two three\n", "'v a b c' must have 3 numbers"),
        ("\0\1\2", "no faces"),
    ],
)
def test_bad_obj_files(tmp_path, text, message):
    """Empty, no faces, index out of range, NaN, degenerate, garbage."""
    (tmp_path / "person.obj").write_text(text)
    with pytest.raises(AvatarError, match=message):
        load_avatar(tmp_path / "person.obj", RIG)


@pytest.mark.parametrize("suffix", [".ply", ".stl"])
def test_truncated_binary_meshes(tmp_path, suffix):
    """Files cut in the header or in the data."""
    trimesh.Trimesh(PERSON.vertices, PERSON.faces, process=False).export(tmp_path / f"person{suffix}")
    data = (tmp_path / f"person{suffix}").read_bytes()
    for length in (0, 40, 200, len(data) // 2, len(data) - 3):
        (tmp_path / f"cut{suffix}").write_bytes(data[:length])
        with pytest.raises(AvatarError, match="it is not a PLY file|cut off|no faces|malformed"):
            load_avatar(tmp_path / f"cut{suffix}", RIG)


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (10, "in decimetres, 1.4"),
        (100, "in centimetres, 1.4"),
        (1 / 0.0254, "in inches, 1.4"),
        (1000, "in millimetres, 1.4"),
        (0.01, "in hectometres, 1.4"),
        (0.001, "in kilometres, 1.4"),
    ],
)
def test_units(tmp_path, factor, unit):
    """A rig file that does not say the unit: it is guessed from the size, and a warning says so."""
    heads, tails = factor * (T_HEADS + AWAY), factor * (T_TAILS + AWAY)
    path = _write_person(tmp_path / "person.obj", rig_json(heads, tails), vertices=factor * (T_VERTICES + AWAY))
    avatar = load_avatar(path, RIG)
    assert distances(avatar.vertices, PERSON.vertices).mean() < 1.5
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1
    assert len(avatar.warnings) == 1 and unit in avatar.warnings[0]


@pytest.mark.parametrize("factor", [4, 0.1])
def test_implausible_sizes(tmp_path, factor):
    """The height found, the range allowed and what to write."""
    with pytest.raises(AvatarError, match='allowed 0.5 to 3.0 m, or 0.95 to 2.4 m in decimetres.*"scale"') as caught:
        load_avatar(_write_person(tmp_path / "person.obj", vertices=T_VERTICES * factor), RIG)
    assert f"is {np.ptp(T_VERTICES[:, 2]) * factor:.4g} m high" in str(caught.value)


def test_a_stated_scale_is_not_guessed_again(tmp_path):
    """A scale that makes a giant is refused."""
    path = _write_person(tmp_path / "person.obj", {"scale": 100})
    with pytest.raises(AvatarError, match=r"is 14\d.\d m high"):
        load_avatar(path, RIG)


def test_bones_that_lie_elsewhere(tmp_path):
    """Bones in another unit than the mesh are noticed, and both sizes named."""
    path = _write_person(tmp_path / "person.obj", rig_json(100 * T_HEADS, 100 * T_TAILS), vertices=T_VERTICES)
    with pytest.raises(AvatarError, match=r"does not fit: 3\d of 36 bones lie outside of the mesh; bones span \["):
        load_avatar(path, RIG)


@pytest.mark.parametrize(("columns", "up"), [([1, 2, 0], "Y"), ([0, 1, 2], "Z"), ([2, 0, 1], "X")])
@pytest.mark.parametrize("vertices", [T_VERTICES, PERSON.vertices])
def test_up_is_guessed(vertices, columns, up):
    """From symmetry and height, in A- and T-pose."""
    assert _upright_axis(np.asarray(vertices)[:, columns], PERSON.faces, "Z") == up


def test_skinning_weights_that_are_not_the_meshs(tmp_path):
    """Both numbers of vertices are named."""
    weights = {"influence_bones": [[0]], "influence_weights": [[1.0]]}
    path = _write_person(tmp_path / "person.obj", {**rig_json(T_HEADS, T_TAILS, weights=False), **weights})
    with pytest.raises(AvatarError, match=r"for 1 vertices, .* has 13718"):
        load_avatar(path, RIG)
