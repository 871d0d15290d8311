"""Draw `docs/concepts/`, a picture for each thing that the method is made of: python docs/draw_concepts.py

Needs the extras `[view,training]`.
"""

from __future__ import annotations

import numpy as np
import trimesh
from PIL import Image

from draw_gallery import lean_to_stout, named
from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, Draper, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.model.garment import Garment
from physkin_core.model.garment_nodes import pose_nodes
from physkin_core.pictures.picture import BODY_COLOUR, Mesh, contact_sheet, layer_colours, render
from physkin_core.quality import edge_strain, edge_strains
from physkin_core.runtime.bound_garment import plain_skinning
from physkin_core.view.scene.heat_map import STRAIN_BANDS, Bands, parts_of

CONCEPTS = ROOT / "docs" / "concepts"
BONE_COLOURS = (
    *((0.90, 0.30, 0.20), (0.95, 0.70, 0.15), (0.30, 0.65, 0.30), (0.15, 0.60, 0.75), (0.35, 0.35, 0.80)),
    *((0.75, 0.30, 0.70), (0.55, 0.35, 0.20), (0.95, 0.50, 0.60), (0.55, 0.70, 0.15), (0.20, 0.75, 0.60)),
)
"""sRGB, one a bone."""
RADIUS = 0.009
"""Of a garment node that is drawn [m]."""
WEIGHT_BANDS = Bands(
    limits=(0.01, 0.05, 0.15, 0.3, 0.5),
    colours=(None, *STRAIN_BANDS.colours[1:]),
    labels=("none", "to 5 %", "to 15 %", "to 30 %", "to 50 %", "more"),
)
WEIGHTS_OF = ((0.1, 0.0, 0.28), (0.0, 0.27, 0.42), (0.07, 0.12, 0.02))
"""The garment nodes nearest to these points of the T-shirt [m]: chest, sleeve, hem."""
PALE = (0.62, 0.68, 0.72)
QUALITY = 86


def balls(places: np.ndarray, colours: np.ndarray | None = None, radius: float = RADIUS) -> list[Mesh]:
    """Places (m, 3) [m] as balls. colours: (m,) which of `BONE_COLOURS` each has; default the first."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    colours = np.zeros(len(places), dtype=int) if colours is None else colours
    found = []
    for colour in np.unique(colours):
        some = places[colours == colour]
        vertices = (some[:, None] + ball.vertices).reshape(-1, 3)
        faces = (len(ball.vertices) * np.arange(len(some))[:, None, None] + ball.faces).reshape(-1, 3)
        found.append(Mesh(vertices, faces, BONE_COLOURS[colour % len(BONE_COLOURS)]))
    return found


def banded(vertices: np.ndarray, faces: np.ndarray, bands: Bands, values: np.ndarray, *, plain=PALE) -> list[Mesh]:
    """A mesh in the colours of its faces' values (f,)."""
    parts = parts_of(faces, bands.band(values), bands=len(bands.colours), vertex_count=len(vertices))
    return [
        Mesh(vertices[part.vertices], part.faces, colour or plain)
        for part, colour in zip(parts, bands.colours)
        if len(part.faces)
    ]


def save(name: str, pictures: list[np.ndarray], captions: list[str]) -> None:
    """Pictures in a row."""
    sheet = contact_sheet(pictures, columns=len(pictures), captions=captions, gap=4)
    Image.fromarray(sheet).save(CONCEPTS / f"{name}.jpg", quality=QUALITY, optimize=True)
    print(f"wrote {CONCEPTS / name}.jpg")


def draw_nodes() -> None:
    """Garment nodes at rest, posed by their bones, and corrected."""
    model, motion = load_garment_model("tshirt"), load_motion("dance")
    draper = Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))
    bound, body = draper.bound, draper.avatar
    positions = motion.positions_for(model.rig)[45]
    cloud = draper.drape(positions, motion.gravity[45])[:, :3]
    bones, transforms = draper.bone_transforms(positions), draper.node_transforms()
    corrected = np.einsum("mij,mj->mi", transforms[..., :3], bound.node_rest) + transforms[..., 3]
    posed = pose_nodes(bones, bound.node_bone, bound.node_positions)
    skin = body.posed_vertices(bones)
    _, colours = np.unique(bound.node_bone, return_inverse=True)
    shown = {
        "at rest": (body.vertices, bound.vertices, bound.node_rest),
        "posed: each follows its bone": (skin, plain_skinning(bound, bones), posed[..., 3]),
        "corrected by the networks": (skin, cloud, corrected),
    }
    pictures = []
    for surface, cloth, nodes in shown.values():
        bounds = np.stack([cloth.min(axis=0) - 0.03, cloth.max(axis=0) + 0.03])
        meshes = [Mesh(surface, body.faces), Mesh(cloth, bound.faces, PALE), *balls(nodes, colours)]
        pictures.append(render(meshes, size=(300, 320), azimuth=30, bounds=bounds, floor=None))
    save("garment-nodes", pictures, list(shown))


def draw_weights() -> None:
    """How much single garment nodes count at each vertex."""
    model = load_garment_model("tshirt")
    vertices, faces = model.garment.vertices, model.garment.faces
    pictures = []
    for place in WEIGHTS_OF:
        node = int(np.linalg.norm(model.node_rest - place, axis=1).argmin())
        weight = np.where(model.influence_nodes == node, model.influence_weights, 0).sum(axis=1)
        meshes = banded(vertices, faces, WEIGHT_BANDS, weight[faces].mean(axis=1))
        pictures.append(render([*meshes, *balls(model.node_rest[[node]])], size=(300, 260), azimuth=25, floor=None))
    save("skinning-weights", pictures, ["a garment node on the chest", "on a sleeve", "at the hem"])


def draw_layers() -> None:
    """An outfit from the skin outwards, each layer as it is given."""
    garments = named(["trousers", "tshirt"])
    outfit = Outfit(garments, load_avatar(BUNDLED_AVATAR, garments[0].model.rig))
    motion = load_motion("walk")
    positions = motion.positions_for(outfit.rig)[30]
    cloth = [cloud[:, :3].copy() for cloud in outfit.drape(positions, motion.gravity[30])]
    body = outfit.avatar.posed_vertices(outfit.bone_transforms(positions))
    bounds = np.stack([body.min(axis=0), body.max(axis=0)])
    skin = Mesh(body, outfit.avatar.faces[~outfit.body_mask], BODY_COLOUR)
    layers = [Mesh(*each) for each in zip(cloth, (layer.faces for layer in outfit.layers), layer_colours(2))]
    shown = {
        "skin that is not covered": [skin],
        "what shows of the trousers": layers[:1],
        "the T-shirt, made wider for them": layers[1:],
        "the outfit": [skin, *layers],
    }
    pictures = [
        render(meshes, size=(230, 400), azimuth=35, elevation=16, bounds=bounds, floor=bounds[0, 2])
        for meshes in shown.values()
    ]
    save("layers", pictures, list(shown))


def draw_measure() -> None:
    """A lean and a stout body in one size and made to measure, with the strain of the cloth."""
    model, motion = load_garment_model("tshirt"), load_motion("walk")
    positions, gravity = motion.positions_for(model.rig)[20], motion.gravity[20]
    shown = {}
    lean, *_, stout = lean_to_stout(3)
    for who, avatar in (("lean", lean), ("stout", stout)):
        for fit, how in ((0.0, "one size"), (1.0, "made to measure")):
            draper = Draper(model, avatar, fit=fit)
            cloth = draper.drape(positions, gravity)[:, :3].astype(float)
            body = avatar.posed_vertices(draper.bone_transforms(positions))
            rest = draper.rest_garment
            meshes = [Mesh(body, avatar.faces), *banded(cloth, rest.faces, STRAIN_BANDS, strains_of_faces(rest, cloth))]
            bounds = np.stack([cloth.min(axis=0) - 0.04, cloth.max(axis=0) + 0.04])
            caption = f"{who}, {how}: {edge_strain(rest, cloth):.1f} %"
            shown[caption] = render(meshes, size=(260, 320), azimuth=30, bounds=bounds, floor=None)
    save("made-to-measure", list(shown.values()), list(shown))


def strains_of_faces(rest: Garment, cloth: np.ndarray) -> np.ndarray:
    """(f,) mean of the edges of each face [%]."""
    of_edge = {tuple(edge): strain for edge, strain in zip(rest.edges.tolist(), edge_strains(rest, cloth))}
    sides = np.sort(np.stack([rest.faces, np.roll(rest.faces, 1, axis=1)], axis=-1), axis=-1)
    return np.array([np.mean([of_edge[tuple(side)] for side in face]) for face in sides.tolist()])


if __name__ == "__main__":
    CONCEPTS.mkdir(exist_ok=True)
    draw_nodes()
    draw_weights()
    draw_layers()
    draw_measure()
