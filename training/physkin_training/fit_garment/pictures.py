"""Pictures of a garment at rest: on the avatar as it lies, and on the template as it is trained."""

from __future__ import annotations

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.picture import CLOTH_COLOUR, Mesh, contact_sheet, render
from physkin_training.fit_garment.checks import CheckedGarment
from physkin_training.fit_garment.own_pose import OwnPose

__all__ = ["front_and_back", "placement_picture"]

FRONT_AND_BACK = (20, 200)
"""Azimuths [degrees]."""
SIZE = (330, 290)
"""Pixels of one view."""


def placement_picture(checked: CheckedGarment, avatar: Avatar, template: Avatar, own: OwnPose | None) -> np.ndarray:
    """Front and back, (h, w, 3) uint8: on the avatar as the garment lies there, below on the template as it is trained.

    own: the avatar in its own pose, None where no avatar was given. Raises PictureError without the [view] extra.
    """
    trained = front_and_back(template.vertices, template.faces, checked.vertices, checked.faces)
    if own is None:
        return contact_sheet(trained, columns=2, captions=["as it is trained", "back"])
    body = own.vertices if checked.in_own_pose else avatar.vertices
    lying = front_and_back(body, avatar.faces, checked.lying, checked.faces)
    captions = ["on the avatar as it lies" if checked.in_own_pose else "on the avatar, where it was placed", "back"]
    return contact_sheet(lying + trained, columns=2, captions=[*captions, "on the template, as it is trained", "back"])


def front_and_back(
    body: np.ndarray, body_faces: np.ndarray, garment: np.ndarray, faces: np.ndarray
) -> list[np.ndarray]:
    """Two pictures of a garment (n, 3) [m], faces (f, 3), on a body (V, 3)."""
    meshes = [Mesh(body, body_faces), Mesh(garment, faces, CLOTH_COLOUR)]
    return [render(meshes, size=SIZE, azimuth=azimuth, samples=8) for azimuth in FRONT_AND_BACK]
