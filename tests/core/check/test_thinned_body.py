"""Checks of bodies of many triangles look at fewer of them over many poses."""

from dataclasses import replace

import numpy as np
import trimesh
from gltf_person import PERSON

from physkin_core.check.thinned_body import CELL, MANY_FACES, thinned
from physkin_core.model.surface_paths import mesh_edges
from physkin_core.quality import closest_points


def test_usual_bodies_are_left_as_they_are():
    assert thinned(PERSON) is PERSON


def test_a_thinned_body_is_the_same_surface():
    """Each vertex is one of the body's; those of trunk and thighs are off the thinned surface by less than what a cell
    leaves of the curve of an arm, 0.2 mm on average; edges are as few."""
    extra = np.concatenate([PERSON.influence_bones, PERSON.influence_weights], axis=1)
    vertices, faces, width = PERSON.vertices, PERSON.faces, PERSON.influence_bones.shape[1]
    for _ in range(2):
        vertices, faces, extra = trimesh.remesh.subdivide(vertices, faces, vertex_attributes={"extra": extra})
        extra = extra["extra"]
    bones = np.round(extra[:, :width]).astype(np.int32).clip(0, len(PERSON.bone_heads) - 1)
    large = replace(PERSON, vertices=vertices.astype(np.float32), faces=faces, influence_bones=bones)
    large = replace(large, influence_weights=extra[:, width:].astype(np.float32))
    fewer = thinned(large)
    assert len(large.faces) > MANY_FACES > len(fewer.faces)
    assert set(map(tuple, fewer.vertices.tolist())) <= set(map(tuple, large.vertices.tolist()))
    trunk = (np.abs(large.vertices[:, 1]) < 0.25) & (np.abs(large.vertices[:, 2]) < 0.4)  # no face, hands and feet
    off = closest_points(large.vertices[trunk], fewer.vertices, fewer.faces)[0]
    assert off.mean() < 2e-4 and off.max() < CELL
    assert (mesh_edges(fewer.faces)[1] == 1).sum() <= (mesh_edges(large.faces)[1] == 1).sum()
