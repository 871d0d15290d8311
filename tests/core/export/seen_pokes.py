"""What cameras see of an exported file, against what is draped: layers that poke through, and holes."""

import numpy as np
from core.export.gltf_reader import in_root_frame

from physkin_core.check.sight import Cameras, Figure, Surface


def count(reader, outfit, motion, frame, clouds):
    """Pixels of a frame: where the layer over another is to be seen, up to its hem; of these, where the file shows the
    layer beneath; and where it shows neither. clouds: (n, 6) of two whole layers as they are draped."""
    cloth = [
        Surface(cloud[:, :3].astype(np.float64), layer.faces)
        for cloud, layer in zip(clouds, outfit.layers, strict=True)
    ]
    inner, outer = (layer.name for layer in outfit.layers)
    body = outfit.body_to_draw
    bones = outfit.bone_transforms(motion.positions_for(outfit.rig)[frame])
    skin = Surface(body.posed_vertices(bones).astype(np.float64), body.faces)
    cameras = Cameras(np.concatenate([surface.vertices for surface in cloth]))
    worn, without = Figure([*cloth, skin], cameras).first, Figure([cloth[0], skin], cameras).first
    over = (worn.surface == 1) & worn.facing & (without.surface == 0) & without.facing
    file = [
        Surface(in_root_frame(reader.skinned(name, frame), motion, frame), reader.faces(name).astype(np.int64))
        for name in (inner, outer, "body")
    ]
    shown = Figure(file, cameras).first
    beneath, right = shown.surface == 0, (shown.surface == 1) & shown.facing
    return np.array(
        [each.sum() for each in (over, cameras.agreed(over & beneath), cameras.agreed(over & ~beneath & ~right))]
    )
