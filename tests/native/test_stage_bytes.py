"""Bytes that a frame touches: everything it reads and writes counts, what it has no need of does not.

Expected sizes follow from shapes. Bounds leave room for what shapes do not say: arrays begin on cache lines, layers
have biases, and stages hand results on, a few KB each at these sizes."""

from dataclasses import replace

import numpy as np
import pytest
from native_frames import NativeFrame, clouds, told

STAGES = ["posing", "networks", "composition", "skinning", "normals"]
SHAPE = dict(nodes=64, vertices=3200, influences=8, pose_widths=(256, 256), deformer_widths=(128, 128))
ROW = 6 * 4
"""Bytes of a vertex and its normal."""
GROUP = 32


@pytest.fixture
def garment(make_garment):
    """With faces."""
    rng = np.random.default_rng(61)
    bound = make_garment(rng, **SHAPE)
    return replace(bound, faces=rng.integers(0, SHAPE["vertices"], size=(6000, 3)).astype(np.int32))


def weights(*networks):
    """Of all layers, whose outputs are padded to whole groups."""
    return sum(-(-len(matrix) // GROUP) * GROUP * matrix.shape[1] for layers in networks for matrix, _ in layers)


def swaying(sway):
    """A row of a frame that goes on from one before."""
    return told(passed=0.016, sway=sway, elapsed=0.016, moves=1.0)


def test_network_weights_count_in_their_precision(garment):
    """Four bytes, two, and one: in int8 layers that read bone transforms or the pose vector have two."""
    count = {p: NativeFrame([garment], precision=p).stage_bytes() for p in ("fp32", "bf16", "int8")}
    size = weights(garment.pose_layers, garment.deformer_layers)
    first = weights(garment.pose_layers[:1], garment.deformer_layers[:1])
    for precision, least in (("fp32", 4 * size), ("bf16", 2 * size), ("int8", size + first)):
        assert list(count[precision]) == STAGES
        assert least < count[precision]["networks"] < 1.02 * least + 32 * 1024
        assert [count[precision][stage] for stage in STAGES if stage != "networks"] == [
            count["fp32"][stage] for stage in STAGES if stage != "networks"
        ]
    assert count["int8"]["networks"] < count["fp32"]["networks"] / 2


def test_normals_write_the_rows_of_a_garment_with_faces(garment):
    """Skinning then puts vertices into places, four numbers each, and reads no normals at rest. Without faces it writes
    the rows."""
    with_faces = NativeFrame([garment]).stage_bytes()
    without = NativeFrame([replace(garment, faces=np.empty((0, 3), dtype=np.int32))]).stage_bytes()
    rows = ROW * SHAPE["vertices"]
    assert with_faces["normals"] > rows + 16 * SHAPE["vertices"] and without["normals"] == 0
    assert without["skinning"] - with_faces["skinning"] == rows + 12 * SHAPE["vertices"]  # whole blocks
    assert [with_faces[stage] for stage in STAGES[:3]] == [without[stage] for stage in STAGES[:3]]


def test_detail_counts_where_it_is_read(garment, make_garment):
    """Its network weights, and in skinning at least 16 bits for each of the nodes of a vertex."""
    plain = make_garment(np.random.default_rng(61), **SHAPE)
    detailed = make_garment(np.random.default_rng(61), **SHAPE, detail_nodes=300)
    added = weights(detailed.detail_layers, [(detailed.detail_offsets, None)])
    plain, more = (NativeFrame([each]).stage_bytes() for each in (plain, detailed))
    assert 4 * added < more["networks"] - plain["networks"] < 4 * added + 16 * 1024
    assert more["skinning"] - plain["skinning"] >= 2 * 3 * SHAPE["vertices"]


def test_a_sway_network_counts_in_frames_that_sway(make_garment):
    """Not before the first one, nor in a drape by itself after it."""
    bound = make_garment(np.random.default_rng(62), **SHAPE, learnt_sway=True)
    frame, networks = NativeFrame([bound]), []
    for row in (told(), swaying(1.0), swaying(0.5), swaying(0.0), told()):
        clouds(frame, [bound], bound.dof_rest, row)
        networks.append(frame.stage_bytes()["networks"])
    still, swayed = networks[0], networks[1]
    assert networks == [still, swayed, swayed, still, still]
    assert swayed - still > 4 * weights(bound.sway_layers)
    assert still == NativeFrame([bound]).stage_bytes()["networks"]


def test_fabrics_that_are_not_worn_do_not_count(make_garment):
    """Of 50, but for how gravity weighs on each."""
    plain, many = (make_garment(np.random.default_rng(63), **SHAPE, fabrics=fabrics) for fabrics in (0, 50))
    plain, many = (NativeFrame([bound]).stage_bytes() for bound in (plain, many))
    assert plain["networks"] <= many["networks"] <= plain["networks"] + 50 * 4 + 64
    assert 50 * 4 * 2 * sum(SHAPE["pose_widths"]) > 64  # bytes of their modulations, which would have shown


def test_contact_counts_what_it_looked_at(make_garment):
    """Tables of vertices between samples: only in frames in which samples lack something, at most all of them."""
    bound = make_garment(np.random.default_rng(64), **SHAPE, detail_nodes=300, skin_blocks=60)
    bound = replace(bound, touching_gaps=bound.touching_gaps - np.float32(1))
    away = replace(bound, skin_positions=bound.skin_positions + np.float32(50))
    free, (near, far) = NativeFrame([bound.without_contact]), (NativeFrame([each]) for each in (bound, away))
    for frame, each in ((free, bound.without_contact), (near, bound), (far, away)):
        clouds(frame, [each], bound.dof_rest, told())
    without, apart, met = (frame.stage_bytes()["composition"] for frame in (free, far, near))
    between = bound.between_nodes.nbytes + bound.between_weights.nbytes
    of_skin = slice(len(bound.vertices))
    assert near.clearance()[of_skin].min() < 0 and far.clearance()[of_skin].min() == 1
    samples = bound.contact_vertices.nbytes + bound.contact_normals.nbytes
    assert without + samples < apart < met
    assert met - apart > between / 10


def test_garments_of_an_outfit_count_each_for_itself(garment):
    """One that is not there is named."""
    other = replace(garment, faces=garment.faces[:0])
    both, alone = NativeFrame([garment, other]), NativeFrame([other])
    assert both.stage_bytes(1) == alone.stage_bytes() != both.stage_bytes()
    with pytest.raises(IndexError, match="garment 2 of 2"):
        both.stage_bytes(2)
