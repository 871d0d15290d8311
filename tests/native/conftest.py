"""Random bound garments of any size for the native evaluator's tests."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from native_frames import told
from native_library import save_one
from random_models import random_contact, random_detail, random_layers, random_sway_network, unit_rows

from physkin_core.model.sway_network import fold_body
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import drape_poses


def random_bound_garment(
    rng,
    *,
    bones=5,
    dofs=7,
    nodes=6,
    vertices=50,
    influences=3,
    pose_widths=(16, 16),
    projections=(),
    deformer_widths=(12, 12),
    used_bones=None,
    learnt_sway=False,
    detail_nodes=0,
    fabrics=0,
    skin_blocks=0,
):
    """A rig, networks and skinning weights with nothing regular about them, of about a person's size."""

    def box(count, half=1.0):
        return rng.uniform(-half, half, size=(count, 3)).astype(np.float32)

    used = np.sort(rng.choice(bones, size=used_bones or (bones + 1) // 2, replace=False)).astype(np.int32)
    lower = rng.uniform(-2.0, -0.2, size=dofs).astype(np.float32)
    weights = rng.uniform(size=(vertices, influences)) ** 2
    weights[rng.uniform(size=weights.shape) < 0.2] = 0.0  # the same garment node twice and zero weights may occur
    weights[:, 0] += 0.1
    weights /= weights.sum(axis=1, keepdims=True)
    parts = {}
    if learnt_sway:
        network = random_sway_network(rng, dofs, nodes, modulation=8)
        parts |= fold_body(network, rng.normal(size=8))
    if detail_nodes:
        of_each = 1 if detail_nodes == vertices else 3
        places = SimpleNamespace(vertices=box(vertices))
        detail = random_detail(rng, places, detail_nodes, width=deformer_widths[-1], influences=of_each, offset=0.05)
        parts |= {
            "detail_layers": (detail.features,),
            "detail_offsets": detail.offsets,
            "detail_nodes": detail.nodes,
            "detail_weights": detail.weights,
        }
    if fabrics:
        shifts = sum(len(parts["sway_layers"][k][1]) for k in (0, 2)) if learnt_sway else 0
        parts |= {
            "fabric_modulations": rng.uniform(-0.3, 0.3, size=(fabrics, 2 * sum(pose_widths))).astype(np.float32),
            "fabric_weights": rng.uniform(0.5, 2, size=fabrics).astype(np.float32),
            "fabric_sway_shifts": rng.normal(size=(fabrics, shifts)).astype(np.float32),
        }
    pose_sizes = dofs + 3, *pose_widths, 2 * sum(deformer_widths)
    garment = BoundGarment(
        bone_parents=np.array([-1] + [rng.integers(0, j) for j in range(1, bones)], dtype=np.int32),
        bone_heads=box(bones),
        dof_bone=rng.integers(0, bones, size=dofs).astype(np.int32),
        dof_axis=unit_rows(rng, dofs).astype(np.float32),
        dof_rest=rng.uniform(-0.3, 0.3, size=dofs).astype(np.float32),
        dof_lower=lower,
        dof_upper=lower + rng.uniform(0.5, 3.0, size=dofs).astype(np.float32),
        pose_layers=random_layers(rng, pose_sizes, output_scale=0.3, projections=projections),
        deformer_bones=used,
        deformer_layers=random_layers(rng, (12 * len(used), *deformer_widths, 12 * nodes), output_scale=0.1),
        node_bone=rng.integers(0, bones, size=nodes).astype(np.int32),
        node_positions=box(nodes),
        node_rest=box(nodes),
        vertices=box(vertices),
        normals=unit_rows(rng, vertices).astype(np.float32),
        influence_nodes=rng.integers(0, nodes, size=(vertices, influences)).astype(np.int32),
        influence_weights=weights.astype(np.float32),
        **parts,
    )
    if fabrics:
        garment = replace(garment, fabric_pose_layers=garment.pose_layers)
    if not skin_blocks:
        return garment
    (cloth,) = drape_poses(garment, [(garment.dof_rest, (0.0, 0.0, -1.0))], precision="fp32")
    return replace(garment, **random_contact(rng, garment, cloth, skin_blocks=skin_blocks))


@pytest.fixture(scope="session")
def small_bound_file(tmp_path_factory):
    """A bound garment file of a few kilobytes with everything that one can hold."""
    rng = np.random.default_rng(40)
    faces = rng.integers(0, 50, size=(90, 3)).astype(np.int32)
    garment = random_bound_garment(rng, learnt_sway=True, detail_nodes=9, fabrics=2, skin_blocks=3)
    garment = replace(garment, faces=faces)
    path = tmp_path_factory.mktemp("bound") / "small.physkin"
    save_one(garment, path, name="small", fabrics=["jersey", "silk", "felt"])
    return path


@pytest.fixture
def make_garment():
    return random_bound_garment


def random_pose(rng, garment):
    """Joint positions over and a little beyond the limits, and a direction of gravity."""
    span = garment.dof_upper - garment.dof_lower
    positions = rng.uniform(garment.dof_lower - 0.1 * span, garment.dof_upper + 0.1 * span)
    return positions.astype(np.float32), unit_rows(rng, 1)[0].astype(np.float32)


@pytest.fixture
def make_pose():
    return random_pose


@pytest.fixture
def make_frames():
    """Joint positions and rows of a motion that is told anything: several rates, doubled stamps, gaps, jumps, clocks
    that go back, drapes by themselves, any effective gravity."""

    def frames(rng, garment, count):
        positions, gravity = random_pose(rng, garment)
        for _ in range(count):
            far = rng.choice([0, 0.58, 2.0], p=[0.85, 0.1, 0.05]) * (
                np.arange(len(positions)) == rng.integers(len(positions))
            )
            positions = (positions + rng.normal(size=len(positions), scale=0.1 * (far == 0)) + far).astype(np.float32)
            positions = np.clip(positions, garment.dof_lower - 1, garment.dof_upper + 1)
            gravity = 0.9 * gravity + 0.1 * rng.normal(size=3)
            elapsed = rng.choice([1 / 120, 1 / 60, 1 / 15, 0, 0.4, 3, -1], p=[0.3, 0.3, 0.2, 0.1, 0.04, 0.04, 0.02])
            if rng.uniform() < 0.05:
                yield positions, told(gravity)
                continue
            yield (
                positions,
                told(
                    gravity,
                    passed=elapsed if elapsed < 0.3 else -1.0,
                    sway=rng.choice([1.0, 0.4, 0.0], p=[0.8, 0.15, 0.05]),
                    elapsed=elapsed,
                    moves=float(elapsed < 0.3 and rng.uniform() < 0.9),
                    velocity=rng.normal(size=3),
                    turning=rng.normal(size=3),
                ),
            )

    return frames
