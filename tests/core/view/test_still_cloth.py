"""Cloth that stands still on the page is sent once more, in its fabric."""

import io

import numpy as np
import pytest

from physkin_core import Outfit, with_fabric
from physkin_core.avatar.body_model import load_body_model
from physkin_core.export.gltf_still import still_glb
from physkin_core.look.cloth_look import cloth_look, seen_from_afar
from physkin_core.model.garment import vertex_normals
from physkin_core.render.filming import cloth_meshes
from tests.random_models import random_avatar, random_model, sewn_tube

pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")

from physkin_core.view.drawing import Drawing  # noqa: E402
from physkin_core.view.page import Page  # noqa: E402
from physkin_core.view.scene.motion_player import standing_pose  # noqa: E402
from physkin_core.view.scene.scene_state import Frame  # noqa: E402

TEAL = (0.12, 0.44, 0.46)


def test_a_still_file_has_cloth_stitches_and_hems_where_they_are():
    import trimesh

    tube = sewn_tube(columns=24, rings=33)
    look = cloth_look(tube, "denim", np.ones(len(tube.faces), dtype=bool), TEAL)
    meshes = cloth_meshes(look, tube.vertices, tube.faces)
    cloud = np.concatenate([tube.vertices, vertex_normals(tube.vertices, tube.faces)], axis=1)
    scene = trimesh.load(io.BytesIO(still_glb(look, cloud, tube.faces)), file_type="glb")
    assert {each.visual.material.name for each in scene.geometry.values()} == {"denim", "seam", "felled", "thick_hem"}
    for made, mesh in zip(scene.geometry.values(), meshes):
        assert len(made.faces) == len(mesh.faces)
        corners = made.vertices[made.faces][..., [2, 0, 1]]  # from glTF's axes
        np.testing.assert_allclose(corners, mesh.vertices[mesh.faces], atol=1e-6)
        np.testing.assert_allclose(made.visual.uv[made.faces], mesh.places, atol=1e-5)


@pytest.fixture
def page():
    page = Page(port=8570)
    yield page
    page.server.stop()


def test_cloth_is_in_its_fabric_while_it_stands(page):
    """And in the colour that this has from afar once it moves; painted or drawn as wires it stays as it is."""
    rng = np.random.default_rng(0)
    model = with_fabric(
        random_model(rng, rig=load_body_model().rig, garment=sewn_tube(columns=24, rings=33)), "denim:teal"
    )
    outfit = Outfit([model], random_avatar(rng, model.rig))
    rest = model.rig.rest
    cloth = tuple(outfit.drape(rest))
    frame = Frame(
        outfit=outfit,
        pose=standing_pose(rest, outfit.avatar),
        body=outfit.posed_body(rest),
        cloth=cloth,
        plain=(),
        nodes=tuple(each[..., 3] for each in outfit.node_transforms()),
        splats=None,
        colours=(TEAL, TEAL),
        own_colours=None,
        microseconds=1.0,
    )
    drawing = Drawing(page)

    def names():
        return {name for name in page.server.scene._handle_from_node_name if "cloth0/part" in name or "fabric" in name}

    drawing.show(frame)
    assert names() == {"/world/figure/cloth0/part0"}
    assert drawing._surfaces[1].colour == pytest.approx(seen_from_afar("denim:teal", TEAL))
    drawing.stand(frame)
    assert names() == {"/world/figure/fabric0"}
    drawing.show(frame)
    assert names() == {"/world/figure/cloth0/part0"}
    drawing.switches.wireframe = True
    drawing.stand(frame)
    assert names() == {"/world/figure/cloth0/part0"}
