"""Pictures of a garment before and after training: where its mesh lies, how it is worn. They need the [view] extra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.outfit.draper import Draper
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, contact_sheet, render
from physkin_core.render.filming import avatar_mesh, dressed_meshes
from physkin_training.evaluate.contact_sheet import chosen_poses
from physkin_training.fit_garment.checks import CheckedGarment
from physkin_training.fit_garment.own_pose import OwnPose

__all__ = ["at_rest", "in_motion", "placement_picture", "worn_in_two_poses"]

VIEWS = (20, 110, 200)
"""Azimuths [degrees] of the pictures at rest: front, side, back."""
FRONT_AND_BACK, SIZE = (20, 200), (330, 290)
"""Azimuths [degrees] and pixels of all others."""


def placement_picture(
    checked: CheckedGarment, avatar: Avatar, template: Avatar | None, own: OwnPose | None
) -> np.ndarray:
    """Front and back, (h, w, 3) uint8: on the avatar as the garment lies there, below on the template as it is trained.

    template: None for a garment whose place is in doubt, which was not moved there. own: the avatar in its own pose,
    None where no avatar was given; one of the two is there. Raises PictureError without the [view] extra.
    """
    images, captions = [], []
    if own is not None:
        body = own.vertices if checked.in_own_pose else avatar.vertices
        images += _front_and_back([avatar_mesh(avatar, body), Mesh(checked.lying, checked.faces, CLOTH_COLOUR)])
        place = "as it lies" if checked.in_own_pose else "where it was placed"
        captions += [f"on the avatar, {place}", "back"]
    if template is not None:
        cloth = Mesh(checked.vertices, checked.faces, CLOTH_COLOUR)
        images += _front_and_back([avatar_mesh(template, template.vertices), cloth])
        captions += ["on the template, as it is trained", "back"]
    return contact_sheet(images, columns=2, captions=captions)


def at_rest(checked: CheckedGarment, template: Avatar) -> np.ndarray:
    """The mesh on the template, (h, w, 3) uint8, from all sides."""
    meshes = [Mesh(template.vertices, template.faces), Mesh(checked.vertices, checked.faces, CLOTH_COLOUR)]
    return contact_sheet([render(meshes, size=(300, 375), azimuth=view) for view in VIEWS], columns=len(VIEWS))


def in_motion(draper: Draper) -> np.ndarray:
    """The garment on an avatar in a frame of motion, (h, w, 3) uint8: front and back."""
    return contact_sheet(_worn(draper, [1])[0], columns=2)


def worn_in_two_poses(draper: Draper) -> np.ndarray:
    """The garment on an avatar, (h, w, 3) uint8: front and back, in a pose within the joint limits and in motion."""
    images, names = _worn(draper, [0, 1])
    captions = [f"{name}, {side}" for name in names for side in ("front", "back")]
    return contact_sheet(images, columns=4, captions=captions)


def _worn(draper: Draper, chosen: Sequence[int]) -> tuple[list[np.ndarray], list[str]]:
    """Front and back in the chosen ones of two poses, and what these are called."""
    poses, names = chosen_poses(draper.model.rig, count=2, seed=0)
    images, outfit = [], draper.outfit
    for pose in chosen:
        positions, gravity = poses.positions[pose].numpy(), poses.gravity[pose].numpy()
        cloth = draper.drape(positions, gravity)[:, :3]
        images += _front_and_back(dressed_meshes(outfit, outfit.posed_body(positions), [cloth]))
    return images, [names[pose] for pose in chosen]


def _front_and_back(meshes: Sequence[Mesh]) -> list[np.ndarray]:
    return [render(meshes, size=SIZE, azimuth=azimuth, samples=8) for azimuth in FRONT_AND_BACK]
