"""Random rigs, garment models and avatars of any size, and cloth tubes: one whose geodesics are known, one sewn.

Everything is of about a person's size and has nothing regular about it. Dimensions: `b` bones, `d` degrees of freedom,
`m` garment nodes, `n` garment vertices, `K` influences, `V` body vertices.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core import Avatar, DegreeOfFreedom, Garment, GarmentModel, Rig
from physkin_core.model.detail import Detail
from physkin_core.model.garment import vertex_normals
from physkin_core.model.hyper_modulator import token_features
from physkin_core.model.sway_network import SwayNetwork, drive_size, pose_size
from physkin_core.native_module import native
from physkin_core.runtime.bound_garment import BoundGarment

NETWORKS = dict(nodes=128, influences=8, pose_widths=(512,) * 4, deformer_widths=(128,) * 4)
SIZES = {
    "tiny": dict(bones=4, dofs=5, nodes=6, influences=3),
    "default rig": dict(bones=36, dofs=52, rings=36, segments=30, **NETWORKS),
    "paper": dict(bones=128, dofs=117, rings=30, segments=24, **NETWORKS),
}
"""Arguments of `random_model`; "paper" has 128 bones and a pose vector of 120."""


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation (3, 3), uniform over directions of its axes."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def unit_rows(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors (count, 3)."""
    rows = rng.normal(size=(count, 3))
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def tube(*, rings: int = 9, segments: int = 12, radius: float = 0.15, height: float = 0.4) -> Garment:
    """An open cylinder of cloth about Z; vertex (ring r, segment s) has index r * segments + s, outside is outside."""
    angle = 2 * np.pi * np.arange(segments) / segments
    z = np.linspace(-height / 2, height / 2, rings)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    vertices = np.concatenate([np.tile(ring, (rings, 1)), np.repeat(z, segments)[:, None]], axis=1)
    index = np.arange(rings * segments).reshape(rings, segments)
    a, d = index[:-1].ravel(), index[1:].ravel()
    b, c = np.roll(index, -1, axis=1)[:-1].ravel(), np.roll(index, -1, axis=1)[1:].ravel()
    return Garment(vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))


def cape(*, rings: int = 40, segments: int = 80) -> Garment:
    """A cone of cloth from neck to knees about the template body's shoulders and arms, open in front: collar, front
    edges and hem are one rim."""
    about = tube(rings=rings, segments=segments, radius=1.0, height=1.0)
    share = 0.5 - about.vertices[:, 2]
    angle = 0.35 + (2 * np.pi - 0.7) * (np.arange(len(share)) % segments) / (segments - 1)
    forward, aside = 0.10 + 0.42 * share**0.6, 0.12 + 0.62 * share**0.45
    points = np.stack([forward * np.cos(angle) - 0.02, aside * np.sin(angle), 0.56 - 1.05 * share], axis=1)
    column = about.faces % segments
    return Garment(points, about.faces[np.ptp(column, axis=1) < 2])


def undone(garment: Garment, seam: np.ndarray, beyond: np.ndarray, away: np.ndarray) -> Garment:
    """A garment with a seam undone. seam: (n,) bool, its vertices; beyond: (f,) bool, faces on one side of it, whose
    edge is moved by `away` (3,) [m]."""
    vertices, faces = garment.vertices, garment.faces.copy()
    copy = np.arange(len(vertices))
    copy[seam] = len(vertices) + np.arange(seam.sum())
    right = np.isin(faces, np.flatnonzero(seam)).any(axis=1) & beyond
    faces[right] = copy[faces[right]]
    panels = garment.panel_places, garment.panel_faces
    return Garment(np.concatenate([vertices, vertices[seam] + away]), faces, None, *panels)


def opened_in_front(garment: Garment, *, gap: float = 0.0) -> Garment:
    """A garment with a seam down its front, which is undone: neckline, front edges and hem become one rim. The
    right edge is moved aside by `gap` [m]."""
    seam = (np.abs(garment.vertices[:, 1]) < 2e-3) & (garment.vertices[:, 0] > 0.04)
    return undone(garment, seam, garment.vertices[garment.faces, 1].mean(axis=1) < 0, np.array([0.0, -gap, 0.0]))


def sewn_tube(
    *, columns: int = 6, rings: int = 9, width: float = 0.45, height: float = 0.4, shrunk: float = 0.92
) -> Garment:
    """Two panels of `width` by `height` [m], each `columns` quads wide, sewn up at both sides and lying as a `tube` of
    `shrunk` times their size. Both seams are creases."""
    segments = 2 * columns
    lying = tube(rings=rings, segments=segments, radius=shrunk * width / np.pi, height=shrunk * height)
    quad = np.arange((rings - 1) * segments)
    ring, (panel, column) = quad // segments, np.divmod(quad % segments, columns)
    a = (panel * rings + ring) * (columns + 1) + column
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    across, up = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rings))
    places = np.column_stack([across.reshape(-1), up.reshape(-1)])
    seams = np.concatenate([np.arange(side, rings * segments, segments) for side in (0, columns)])
    ends = np.column_stack([seams[:-1], seams[1:]])
    return Garment(
        lying.vertices,
        lying.faces,
        ends[np.arange(len(ends)) != rings - 1],
        np.concatenate([places, places + [width + 0.1, 0.0]]),
        np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]),
    )


def write_sewn(path: Path, garment: Garment) -> None:
    """As an OBJ with `vt` in metres and its creases as line elements."""
    lines = ["v {:.8f} {:.8f} {:.8f}".format(*vertex) for vertex in garment.vertices]
    lines += ["vt {:.8f} {:.8f}".format(*place) for place in garment.panel_places]
    for face, panel_face in zip(garment.faces + 1, garment.panel_faces + 1):
        lines.append("f " + " ".join(f"{vertex}/{place}" for vertex, place in zip(face, panel_face)))
    if garment.creases is not None:
        lines += [f"l {a} {b}" for a, b in garment.creases + 1]
    path.write_text("\n".join(lines) + "\n")


def tube_geodesics(vertices: np.ndarray, source: int, radius: float = 0.15) -> np.ndarray:
    """Exact distance (n,) along the smooth cylinder from one vertex of `tube` to every other."""
    angle = np.arctan2(vertices[:, 1], vertices[:, 0])
    turn = np.abs(angle - angle[source])
    turn = np.minimum(turn, 2 * np.pi - turn)
    return np.hypot(radius * turn, vertices[:, 2] - vertices[source, 2])


def random_rig(rng: np.random.Generator, *, bones: int = 5, dofs: int = 7) -> Rig:
    """A random tree of bones, degrees of freedom in any order on any bone about any axis, rests that are not zero."""
    heads = rng.uniform(-1, 1, size=(bones, 3))
    heads[0] = 0
    lower = rng.uniform(-2.0, -0.2, size=dofs)
    upper = lower + rng.uniform(0.5, 3.0, size=dofs)
    return Rig(
        bone_names=tuple(f"bone{k}" for k in range(bones)),
        parents=np.array([-1] + [rng.integers(0, k) for k in range(1, bones)]),
        heads=heads,
        tails=heads + rng.uniform(0.05, 0.4, size=(bones, 1)) * unit_rows(rng, bones),
        dofs=tuple(
            DegreeOfFreedom(
                name=f"joint{k}",
                bone=f"bone{rng.integers(bones)}",
                axis=tuple(rng.uniform(0.5, 2.0) * unit_rows(rng, 1)[0]),
                lower=float(lower[k]),
                upper=float(upper[k]),
                rest=float(rng.uniform(-0.3, 0.3)),
            )
            for k in range(dofs)
        ),
    )


def random_layers(
    rng: np.random.Generator, sizes: tuple[int, ...], *, output_scale: float, projections: tuple[int, ...] = ()
) -> tuple:
    """He-initialised layers through `sizes`; outputs have about the size `output_scale`. projections: indices of layers
    without a bias."""
    layers = []
    for k, (inputs, outputs) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
        gain = np.sqrt((1 if k in projections else 2) / inputs)
        if k + 2 == len(sizes):
            gain = output_scale / np.sqrt(inputs)
        weight, bias = rng.normal(size=(outputs, inputs)) * gain, rng.normal(size=outputs, scale=0.05)
        layers.append((weight.astype(np.float32), bias[: 0 if k in projections else None].astype(np.float32)))
    return tuple(layers)


def random_hyper_modulator(
    rng: np.random.Generator, outputs: int, *, width: int = 8, feed_forward: int = 16, blocks: int = 2
) -> dict[str, np.ndarray]:
    """Arrays of a hyper modulator whose every part matters to the result, layer norms included."""
    linear = {
        "embed": (width, token_features()),
        "attention.input": (3 * width, width),
        "attention.output": (width, width),
        "feed_forward.0": (feed_forward, width),
        "feed_forward.1": (width, feed_forward),
        "pool": (1, width),
        "output": (outputs, width),
    }
    norms = ["norm_1", "norm_2"]
    for k in range(blocks):
        linear |= {f"residual.{k}.0": (2 * width, width), f"residual.{k}.1": (width, 2 * width)}
        norms.append(f"residual.{k}.norm")
    arrays = {}
    for name, shape in linear.items():
        gain = 0.2 if name == "output" else 1.5
        arrays[f"{name}.weight"] = rng.normal(size=shape) * gain / np.sqrt(shape[1])
        arrays[f"{name}.bias"] = 0.1 * rng.normal(size=shape[0])
    for name in norms:
        arrays[f"{name}.weight"] = rng.uniform(0.5, 1.5, size=width)
        arrays[f"{name}.bias"] = 0.2 * rng.normal(size=width)
    arrays |= {"fit": rng.normal(size=width), "bend": rng.normal(size=width)}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def random_model(
    rng: np.random.Generator,
    *,
    rig: Rig | None = None,
    garment: Garment | None = None,
    bones: int = 5,
    dofs: int = 7,
    nodes: int = 10,
    influences: int = 4,
    rings: int = 9,
    segments: int = 12,
    pose_widths: tuple[int, ...] = (16, 16),
    pose_rank: int = 0,
    deformer_widths: tuple[int, ...] = (12, 12),
    width: int = 8,
    correction: float = 0.1,
    learnt_sway: bool = False,
    detail_nodes: int = 0,
) -> GarmentModel:
    """A garment model with random networks and smooth random skinning weights.

    rig, garment: default a random rig of `bones` and `dofs`, and a `tube` of `rings` by `segments`. correction: about
    how large the node deformer's numbers are. learnt_sway: it has a sway network. detail_nodes: that it has.
    pose_rank: of the pose modulator's layers but the first.
    """
    rig = random_rig(rng, bones=bones, dofs=dofs) if rig is None else rig
    garment = tube(rings=rings, segments=segments) if garment is None else garment
    chosen = rng.choice(len(garment.vertices), size=nodes, replace=False)
    rest = garment.vertices[chosen].astype(np.float32)
    distance = np.linalg.norm(garment.vertices[:, None] - rest, axis=-1)
    influence_nodes = np.argsort(distance, axis=1)[:, :influences]
    weights = np.exp(-np.take_along_axis(distance, influence_nodes, axis=1) / 0.05) * rng.uniform(
        0.5, 1.5, size=influence_nodes.shape
    )
    deformer = random_layers(rng, (12 * nodes, *deformer_widths, 12 * nodes), output_scale=correction)
    pose_sizes = [rig.pose_size, pose_widths[0]]
    for after in (*pose_widths[1:], 2 * sum(deformer_widths)):
        pose_sizes += [pose_rank, after] if pose_rank else [after]
    projections = tuple(range(1, len(pose_sizes) - 1, 2)) if pose_rank else ()
    pose = random_layers(rng, tuple(pose_sizes), output_scale=0.3, projections=projections)
    node_bone = rng.integers(0, rig.bone_count, size=nodes).astype(np.int32)
    hyper = random_hyper_modulator(rng, 2 * sum(pose_widths), width=width)
    return GarmentModel(
        name="random",
        rig=rig,
        garment=garment,
        rest_normals=vertex_normals(garment.vertices, garment.faces).astype(np.float32),
        node_rest=rest,
        node_bone=node_bone,
        influence_nodes=influence_nodes.astype(np.int32),
        influence_weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        engine_nodes=influence_nodes[:, :2].astype(np.int32),
        engine_weights=(weights[:, :2] / weights[:, :2].sum(axis=1, keepdims=True)).astype(np.float32),
        hyper_modulator=hyper,
        pose_modulator=pose,
        node_deformer=deformer,
        sway=random_sway_network(rng, len(rig.dofs), nodes, modulation=2 * sum(pose_widths)) if learnt_sway else None,
        detail=random_detail(rng, garment, detail_nodes, width=deformer_widths[-1]) if detail_nodes else None,
        training={"seed": 7, "bodies": 3},
        scores={"edge_strain_percent": 3.5},
    )


def random_detail(
    rng: np.random.Generator,
    garment: Garment,
    nodes: int,
    *,
    width: int,
    features: int = 7,
    influences: int = 3,
    offset: float = 0.02,
) -> Detail:
    """Detail nodes at random vertices, which move by about `offset` [m]."""
    places = garment.vertices[rng.choice(len(garment.vertices), size=nodes, replace=False)]
    distance = np.linalg.norm(garment.vertices[:, None] - places, axis=-1)
    nearest = np.argsort(distance, axis=1)[:, :influences].astype(np.int32)
    weights = rng.uniform(0.2, 1.0, size=nearest.shape)
    return Detail(
        features=(
            rng.normal(size=(features, width)).astype(np.float32),
            rng.normal(size=features).astype(np.float32),
        ),
        offsets=(offset * rng.normal(size=(3 * nodes, features))).astype(np.float32),
        nodes=nearest,
        weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
    )


def random_sway_network(
    rng: np.random.Generator,
    dofs: int,
    nodes: int,
    *,
    modulation: int,
    joints: int = 4,
    states: int = 10,
    widths: tuple[int, int, int] = (13, 20, 11),
    code: int = 3,
    offset: float = 0.05,
) -> SwayNetwork:
    """A sway network whose every part matters. offset: about how large its numbers are."""
    hidden, read, last = widths
    drive, pose = drive_size(joints), pose_size(joints)
    floats = lambda *shape: rng.normal(size=shape).astype(np.float32)  # noqa: E731
    (first,), (driven,), (gate,), (reading, latter, out) = (
        random_layers(rng, sizes, output_scale=scale)
        for sizes, scale in (
            ((drive, hidden), 1.0),
            ((hidden, 2 * states), 2.0),
            ((hidden, states), 1.0),
            ((2 * states + pose + drive, read, last, 12 * nodes), offset),
        )
    )
    return SwayNetwork(
        joints=np.sort(rng.choice(dofs, size=joints, replace=False)).astype(np.int32),
        first=first,
        first_code=0.3 * floats(hidden, code),
        drive=driven,
        gate=gate,
        rates=np.exp(rng.uniform(0, 2.5, size=states)).astype(np.float32),
        turns=rng.uniform(0, 25, size=states).astype(np.float32),
        read=reading,
        read_code=0.3 * floats(read, code),
        last=latter,
        out=out,
        code_mean=0.1 * floats(modulation),
        code_directions=floats(code, modulation) / np.float32(np.sqrt(modulation)),
    )


def random_contact(
    rng: np.random.Generator, bound: BoundGarment, cloth: np.ndarray, *, skin_blocks: int = 11, bones: int = 2
) -> dict[str, np.ndarray]:
    """Fields by which a garment is kept out of patches of skin, each near the cloth (n, 6) of the canonical pose and on
    `bones` random bones: every second vertex is a sample, of a garment with detail the others lie between them."""
    size, block = native.constants["block"], native.constants["skin_block"]
    middles = cloth[::2][rng.integers(-(-len(cloth) // 2), size=skin_blocks)]
    facing = np.repeat(rng.choice([-1, 1], size=(skin_blocks, 1)) * middles[:, 3:], block, axis=0)
    points = np.repeat(middles[:, :3], block, axis=0) + rng.normal(size=(skin_blocks * block, 3), scale=0.02)
    facing = facing + 0.1 * rng.normal(size=facing.shape)
    weights = rng.uniform(0.1, 1, size=(len(points), bones))
    samples, between = np.arange(0, len(bound.vertices), 2), np.arange(1, len(bound.vertices), 2)
    names = ("vertices", "normals", "influence_nodes", "influence_weights", "detail_nodes", "detail_weights")
    sampled = {
        name: array[samples] if len(array := getattr(bound, name)) else np.empty((len(samples), 0), array.dtype)
        for name in names
    }
    found = {f"contact_{name}": array for name, array in sampled.items()} | {
        "skin_positions": points,
        "skin_normals": facing / np.linalg.norm(facing, axis=1, keepdims=True),
        "skin_bones": np.repeat(rng.integers(len(bound.bone_parents), size=(skin_blocks, bones)), block, axis=0),
        "skin_weights": weights / weights.sum(axis=1, keepdims=True),
        "contact_gaps": rng.uniform(0, 0.01, size=len(samples)),
        "contact_hangs": rng.uniform(size=len(samples)),
        "contact_sides": rng.choice([1, -1, 0], p=[0.5, 0.45, 0.05], size=(-(-len(samples) // size), skin_blocks)),
    }
    if len(bound.detail_nodes) and len(between):
        found |= {
            "between_nodes": bound.detail_nodes[between],
            "between_weights": bound.detail_weights[between],
            "between_heights": rng.uniform(-0.01, 0.01, size=len(between)),
            "between_gaps": rng.uniform(0, 0.01, size=len(between)),
            "between_blocks": rng.integers(len(found["contact_sides"]), size=-(-len(between) // size)),
            "touching_samples": np.tile(rng.integers(len(samples), size=size), 3),
            "touching_gaps": rng.uniform(0, 0.01, size=3 * size),
            "touching_sides": np.array([[0, 1, 1], [2, 0, -1], [2, -1, 0]]),
        }
    types = {"f": np.float32, "i": np.int32}
    return {name: np.ascontiguousarray(array, dtype=types[array.dtype.kind]) for name, array in found.items()}


def random_avatar(rng: np.random.Generator, rig: Rig, *, influences: int = 3) -> Avatar:
    """Another body for a rig: a bumpy ball with its own bone positions and random skinning."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    vertices = np.asarray(ball.vertices) * rng.uniform(0.9, 1.1, size=(len(ball.vertices), 1))
    weights = rng.uniform(size=(len(vertices), influences))
    heads = rig.heads + 0.05 * rng.normal(size=rig.heads.shape)
    heads[0] = 0
    return Avatar(
        vertices=vertices.astype(np.float32),
        faces=np.asarray(ball.faces).astype(np.int32),
        bone_heads=heads.astype(np.float32),
        bone_tails=(heads + (rig.tails - rig.heads) * rng.uniform(0.7, 1.3, size=(rig.bone_count, 1))).astype(
            np.float32
        ),
        influence_bones=rng.integers(0, rig.bone_count, size=weights.shape).astype(np.int32),
        influence_weights=(weights / weights.sum(axis=1, keepdims=True)).astype(np.float32),
        source="random body",
    )


def random_pose(rng: np.random.Generator, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (d,) float32 over and a little beyond the limits, and a gravity direction (3,) float32."""
    span = rig.upper - rig.lower
    positions = rng.uniform(rig.lower - 0.1 * span, rig.upper + 0.1 * span)
    return positions.astype(np.float32), unit_rows(rng, 1)[0].astype(np.float32)
