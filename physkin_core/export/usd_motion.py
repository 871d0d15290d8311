"""A draped motion as USD: every vertex of body and garments in every frame, exact (extra `[usd]`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.picture import BODY_COLOUR, layer_colours

__all__ = ["write_usd_motion"]


def write_usd_motion(path: Path, outfit: Outfit, motion: Motion) -> None:
    """Write avatar and garments in motion as .usd, .usda or .usdc: meshes under a moving root, metres, Z up, with all
    points at each frame. Raises ModuleNotFoundError without usd-core, OSError when it cannot be written."""
    from pxr import Gf, Usd, UsdGeom

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(motion.rate_hz)
    stage.SetFramesPerSecond(motion.rate_hz)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(motion.frame_count - 1)
    root = UsdGeom.Xform.Define(stage, "/avatar")
    stage.SetDefaultPrim(root.GetPrim())
    place = root.AddTranslateOp()
    turn = root.AddOrientOp()
    colours = [BODY_COLOUR, *layer_colours(len(outfit.models))]
    names = ["body", *(_as_identifier(model.name) for model in outfit.models)]
    faces = [outfit.avatar.faces[~outfit.body_mask], *outfit.faces]
    meshes = []
    for name, triangles, colour in zip(names, faces, colours):
        mesh = UsdGeom.Mesh.Define(stage, f"/avatar/{name}")
        mesh.CreateFaceVertexCountsAttr(np.full(len(triangles), 3, dtype=np.int32))
        mesh.CreateFaceVertexIndicesAttr(triangles.reshape(-1).astype(np.int32))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateDoubleSidedAttr(True)
        mesh.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        meshes.append(mesh)
    rig = outfit.models[0].rig
    for frame, (positions, time, root_now) in enumerate(zip(motion.positions_for(rig), motion.times, motion.root)):
        clouds = outfit.drape(positions, time=time, root=root_now)
        body = outfit.avatar.posed_vertices(outfit.bone_transforms(positions))
        for mesh, points in zip(meshes, [body, *clouds]):
            points = np.ascontiguousarray(points, dtype=np.float32)
            mesh.GetPointsAttr().Set(points[:, :3].copy(), frame)
            mesh.GetExtentAttr().Set(np.stack([points[:, :3].min(axis=0), points[:, :3].max(axis=0)]), frame)
            if points.shape[1] == 6:
                mesh.GetNormalsAttr().Set(points[:, 3:].copy(), frame)
        x, y, z, w = map(float, motion.root_orientation[frame])
        turn.Set(Gf.Quatf(w, x, y, z), frame)
        place.Set(Gf.Vec3d(*map(float, motion.root_position[frame])), frame)
    if not stage.Export(str(path)):
        raise OSError(f"cannot write {path}")


def _as_identifier(name: str) -> str:
    """A garment's name as USD allows: letters, digits and underscores, no digit first."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return plain if not plain[:1].isdigit() else f"_{plain}"
