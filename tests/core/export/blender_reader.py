"""Read a file with Blender, in a process of its own: python blender_reader.py FILE RATE FRAMES OUT.npz

OUT has positions (v, 3) of every mesh in Blender's world, as "name/frame", and names of images, "pictures".
"""

import sys

import bpy
import numpy as np


def read(path, rate, frames):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = rate
    if path.endswith(".glb"):
        bpy.ops.import_scene.gltf(filepath=path)
    else:
        bpy.ops.wm.usd_import(filepath=path)
    found = {}
    for frame in frames:
        scene.frame_set(frame)
        now = bpy.context.evaluated_depsgraph_get()
        for each in (each for each in bpy.data.objects if each.type == "MESH"):
            moved = each.evaluated_get(now)
            points = np.empty(3 * len(moved.data.vertices))
            moved.data.vertices.foreach_get("co", points)
            world = np.array(moved.matrix_world)
            found[f"{each.name}/{frame}"] = points.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3]
    return found | {"pictures": np.array([image.name for image in bpy.data.images if image.size[0]])}


np.savez(sys.argv[4], **read(sys.argv[1], int(sys.argv[2]), [int(frame) for frame in sys.argv[3].split(",")]))
