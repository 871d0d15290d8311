"""A camera that films a dressed avatar as it moves through the world.

Dimensions: `T` frames. Metres; world with Z up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import Mesh, render
from physkin_core.progress import Watch
from physkin_core.render.dressed_meshes import dressed_meshes

__all__ = ["Camera", "film"]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Where it stands and what it takes.

    azimuth: [degrees] as of `picture.render`, in the world: 0 looks at a body that faces X from the front, 90 from its
    left; as near as all that is filmed fits. follow: go with the root over the floor, else stand still. size: w, h
    [pixels]. samples: light paths a pixel.
    """

    azimuth: float = 30.0
    follow: bool = True
    size: tuple[int, int] = (480, 600)
    samples: int = 8


def film(outfit: Outfit, motion: Motion, camera: Camera, *, watch: Watch = lambda share: None) -> Iterator[np.ndarray]:
    """Pictures (h, w, 3) uint8 of each frame. watch: told how much is drawn.

    Cloth sways as `Outfit.sway` says. Everything is draped twice, which takes little beside drawing: first to see how
    much room it needs. The floor is where the lowest vertex of all frames is. Raises PictureError as `picture.render`
    does.
    """
    places = motion.root_position * [1, 1, 0] if camera.follow else np.zeros((motion.frame_count, 3))
    corners = []
    for place, meshes in zip(places, _frames(outfit, motion)):
        points = np.concatenate([mesh.vertices for mesh in meshes])
        corners.append([points.min(axis=0) - place, points.max(axis=0) - place])
    lows, highs = np.moveaxis(np.array(corners), 1, 0)
    bounds = np.stack([lows.min(axis=0), highs.max(axis=0)])
    for frame, (place, meshes) in enumerate(zip(places, _frames(outfit, motion))):
        watch(frame / motion.frame_count)
        yield render(
            meshes,
            size=camera.size,
            azimuth=camera.azimuth,
            bounds=bounds + place,
            floor=float(bounds[0, 2]),
            samples=camera.samples,
        )
    watch(1.0)


def _frames(outfit: Outfit, motion: Motion) -> Iterator[list[Mesh]]:
    """Body and garments of each frame, in the world."""
    turns = Rotation.from_quat(motion.root_orientation)
    positions = motion.positions_for(outfit.rig)
    outfit.reset()
    for pose, time, root, turn, place in zip(positions, motion.times, motion.root, turns, motion.root_position):
        cloth = outfit.drape(pose, time=time, root=root)
        body = outfit.posed_body(pose)
        yield dressed_meshes(outfit, *_moved(turn, place, [body, *cloth]))


def _moved(turn: Rotation, place: np.ndarray, clouds: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Positions of body and garments from root to world."""
    body, *cloth = (turn.apply(cloud[:, :3]) + place for cloud in clouds)
    return body, cloth
