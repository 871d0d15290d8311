"""Draw `docs/blender.jpg`, exported files in Blender beside our own picture: python docs/draw_blender.py

Needs `pip install bpy`, besides the extras `[view,usd]`; says so and ends where it is missing.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

from draw_gallery import meshes_at, named
from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main as physkin
from physkin_core.mesh.look import LIBRARY, Look
from physkin_core.mesh.mesh_file import write_obj
from physkin_core.model.garment import Garment
from physkin_core.pictures.picture import contact_sheet, render

DRAWING = ROOT / "docs" / "blender.jpg"
GARMENTS, LOOKS = ("trousers", "tshirt"), "tshirt"
RATE, FRAME = 10, 7
SIZE = (300, 420)
AZIMUTH, ELEVATION, DISTANCE, FIELD_OF_VIEW = 30.0, 8.0, 5.6, 20.0
"""Of all cameras: degrees, metres."""
SQUARE = 0.06
"""[m] Of the checker on the T-shirt."""


def checkered(garment: Garment) -> Look:
    """A garment unrolled about the upright axis, with a checker as its picture."""
    x, y, z = garment.vertices.T
    turn = (np.arctan2(y, x) / (2 * np.pi))[garment.faces]
    turn -= np.round(turn - turn[:, :1])
    places = np.stack([8 * turn, z[garment.faces] / (2 * SQUARE)], axis=-1)
    squares = np.kron([[1, 0], [0, 1]], np.ones((32, 32)))[..., None]
    picture = io.BytesIO()
    Image.fromarray((squares * [225, 205, 165] + (1 - squares) * [165, 50, 45]).astype(np.uint8)).save(picture, "PNG")
    files = {LIBRARY: b"newmtl checker\nmap_Kd checker.png\n", "checker.png": picture.getvalue()}
    none = np.full(len(garment.faces), -1)
    return Look(places, np.zeros_like(none), none, ("checker",), (), files)


def draw_in_blender(source: str, picture: str) -> None:
    """A picture of a file, in a process of its own: Blender brings other versions of our renderer's libraries."""
    import bpy
    from mathutils import Matrix, Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = RATE
    gltf = source.endswith(".glb")
    bpy.ops.import_scene.gltf(filepath=source) if gltf else bpy.ops.wm.usd_import(filepath=source)
    scene.frame_set(FRAME)
    body = bpy.data.objects["body"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    corners = [body.matrix_world @ Vector(corner) for corner in body.bound_box]
    middle = sum(corners, Vector()) / len(corners)
    azimuth = np.radians(AZIMUTH - (90 if gltf else 0))  # glTF's forward is Blender's -Y
    level, up = np.cos(np.radians(ELEVATION)), np.sin(np.radians(ELEVATION))
    back = Vector((level * np.cos(azimuth), level * np.sin(azimuth), up))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit, camera.data.angle = "VERTICAL", np.radians(FIELD_OF_VIEW)
    camera.matrix_world = (
        Matrix.Translation(middle + DISTANCE * back) @ back.to_track_quat("Z", "Y").to_matrix().to_4x4()
    )
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN"))
    lamp.data.energy, lamp.rotation_euler = 1.0, (0.6, 0.3, azimuth + 1.2)
    for each in (camera, lamp):
        scene.collection.objects.link(each)
    scene.camera, scene.world = camera, bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    scene.render.engine, scene.cycles.samples = "CYCLES", 24
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)


def main() -> None:
    """Write the picture."""
    if find_spec("bpy") is None:
        print("docs/blender.jpg is left as it is: it needs pip install bpy")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        garment = load_garment_model(LOOKS).garment
        write_obj(folder / "garment.obj", garment.vertices, garment.faces, checkered(garment), header="checker")
        worn = [word for each in GARMENTS for word in ("-g", each)]
        motion = load_motion("walk").resampled(RATE)
        outfit = Outfit(named(GARMENTS), load_avatar(BUNDLED_AVATAR, load_garment_model(LOOKS).rig))
        meshes = meshes_at(outfit, motion, FRAME)
        view = {"azimuth": AZIMUTH, "elevation": ELEVATION, "distance": DISTANCE, "floor": None}
        body = meshes[0].vertices
        view["bounds"] = np.stack([body.min(axis=0), body.max(axis=0)])
        pictures = [render(meshes, size=SIZE, **view)]
        for kind in (".glb", ".usdc"):
            file, picture = str(folder / f"walk{kind}"), str(folder / f"walk{kind}.png")
            look = str(folder / "garment.obj")
            physkin(["export", "walk", *worn, "--materials", look, "--rate", str(RATE), "-o", file])
            subprocess.run([sys.executable, __file__, file, picture], check=True, stdout=subprocess.DEVNULL)
            pictures.append(np.array(Image.open(picture).convert("RGB")))
        captions = ["physkin, plain", "Blender, .glb with --materials", "Blender, .usdc with --materials"]
        sheet = contact_sheet(pictures, columns=3, captions=captions, gap=4)
    Image.fromarray(sheet).save(DRAWING, quality=86, optimize=True)
    print(f"wrote {DRAWING}")


if __name__ == "__main__":
    draw_in_blender(*sys.argv[1:]) if len(sys.argv) == 3 else main()
