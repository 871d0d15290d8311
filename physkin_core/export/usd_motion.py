"""A draped motion as USD: every vertex of body and garments in every frame, exact (extra `[usd]`)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from physkin_core.look.cloth_look import cloth_colours
from physkin_core.mesh.look import Look
from physkin_core.mesh.surfaces import Part, Picture, Surface, parts_of
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit
from physkin_core.pictures.picture import BODY_COLOUR

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom, UsdShade

__all__ = ["write_usd_motion"]


def write_usd_motion(path: Path, outfit: Outfit, motion: Motion, *, looks: Sequence[Look | None]) -> list[str]:
    """Write avatar and garments in motion as .usd or .usdc: meshes under a moving root, metres, Z up, with all
    points at each frame. Returns sentences on what it cannot show: none, as it shows all.

    looks: of the body's faces that are shown, as of `avatar_look`, and of each garment, as of `garment_looks`; None
    for a colour. Their pictures are written into a folder beside the file, `walk_pictures` for `walk.usdc`.
    Raises ModuleNotFoundError without usd-core, OSError when it cannot be written.
    """
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
    colours = [BODY_COLOUR, *cloth_colours(outfit.garments)]
    names = _as_identifiers(["body", *(layer.name for layer in outfit.layers)])
    faces = [outfit.body_to_draw.faces[outfit.faces_to_draw], *(layer.faces for layer in outfit.layers)]
    meshes = [
        [(_mesh(stage, part, colour, path), part) for part in parts_of(look, name, colour, triangles)]
        for name, triangles, colour, look in zip(names, faces, colours, looks)
    ]
    rig = outfit.rig
    outfit.reset()
    for frame, (positions, time, root_now) in enumerate(zip(motion.positions_for(rig), motion.times, motion.root)):
        clouds = outfit.drape(positions, time=time, root=root_now)
        body = outfit.posed_body(positions)
        for parts, points in zip(meshes, [body, *clouds]):
            for mesh, part in parts:
                _move(mesh, np.ascontiguousarray(part.on(points), dtype=np.float32), frame)
        x, y, z, w = map(float, motion.root_orientation[frame])
        turn.Set(Gf.Quatf(w, x, y, z), frame)
        place.Set(Gf.Vec3d(*map(float, motion.root_position[frame])), frame)
    if not stage.Export(str(path)):
        raise OSError(f"cannot write {path}")
    return []


def _mesh(stage: Usd.Stage, part: Part, colour: tuple[float, float, float], path: Path) -> UsdGeom.Mesh:
    """Without points yet. colour: sRGB, for what shows no materials."""
    from pxr import Gf, UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, f"/avatar/{part.name}")
    mesh.CreateFaceVertexCountsAttr(np.full(len(part.faces), 3, dtype=np.int32))
    mesh.CreateFaceVertexIndicesAttr(part.faces.reshape(-1).astype(np.int32))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    _paint(mesh, part.look, part.surfaces, path)
    return mesh


def _move(mesh: UsdGeom.Mesh, points: np.ndarray, frame: int) -> None:
    """Place it in a frame. points: (n, 3), or (n, 6) with normals, float32."""
    mesh.GetPointsAttr().Set(points[:, :3].copy(), frame)
    mesh.GetExtentAttr().Set(np.stack([points[:, :3].min(axis=0), points[:, :3].max(axis=0)]), frame)
    if points.shape[1] == 6:
        mesh.GetNormalsAttr().Set(points[:, 3:].copy(), frame)


def _paint(mesh: UsdGeom.Mesh, look: Look | None, surfaces: Sequence[Surface], path: Path) -> None:
    """Give a mesh its texture coordinates, and its materials by subsets of faces."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    if look is not None:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        places = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.faceVarying)
        places.Set(np.nan_to_num(look.uv).reshape(-1, 2).astype(np.float32))
    binding = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    wanted = [surface.name for surface in surfaces]
    names = _as_identifiers([*wanted, *(f"faces_{name}" for name in wanted)])  # both stand beneath the mesh
    for surface, name, subset_name in zip(surfaces, names, names[len(surfaces) :]):
        indices = Vt.IntArray.FromNumpy(surface.faces.astype(np.int32))
        subset = binding.CreateMaterialBindSubset(subset_name, indices)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(_material(mesh, name, surface, path))


def _material(mesh: UsdGeom.Mesh, name: str, surface: Surface, path: Path) -> UsdShade.Material:
    from pxr import Gf, Sdf, UsdShade

    stage, place = mesh.GetPrim().GetStage(), mesh.GetPath().AppendChild(name)
    material = UsdShade.Material.Define(stage, place)

    def shader(kind: str, of: str = "", **inputs) -> UsdShade.Shader:
        """of: what it is for, where there are several."""
        made = UsdShade.Shader.Define(stage, place.AppendChild(f"{kind}_{of}" if of else kind))
        made.CreateIdAttr(kind)
        for key, (of_type, value) in inputs.items():
            made.CreateInput(key, of_type).Set(value)
        return made

    types = Sdf.ValueTypeNames
    colour = Gf.Vec3f(*surface.colour)
    preview = shader(
        "UsdPreviewSurface", roughness=(types.Float, surface.roughness), diffuseColor=(types.Color3f, colour)
    )
    material.CreateSurfaceOutput().ConnectToSource(preview.ConnectableAPI(), "surface")
    folder = path.with_name(f"{path.stem}_pictures")

    def texture(picture: Picture, repeats: tuple[float, float], space: str, **inputs) -> UsdShade.ConnectableAPI:
        """The picture's shader, and the picture in its folder."""
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / f"{mesh.GetPrim().GetName()}_{picture.name}"  # two garments may have a knit.png
        file.write_bytes(picture.content)
        asset = Sdf.AssetPath(f"./{folder.name}/{file.name}")
        kind = "normals" if space == "raw" else ""
        made = shader("UsdUVTexture", kind, file=(types.Asset, asset), **inputs)
        made.CreateInput("sourceColorSpace", types.Token).Set(space)
        for side in ("wrapS", "wrapT"):
            made.CreateInput(side, types.Token).Set("repeat")
        reader = shader("UsdPrimvarReader_float2", kind, varname=(types.String, "st"))
        if repeats != (1.0, 1.0):
            scaled = shader("UsdTransform2d", kind, scale=(types.Float2, Gf.Vec2f(*repeats)))
            scaled.CreateInput("in", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
            reader = scaled
        made.CreateInput("st", types.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        return made.ConnectableAPI()

    if surface.picture is not None:
        tint = Gf.Vec4f(*surface.colour, 1.0)
        shown = texture(surface.picture, surface.repeats, "sRGB", scale=(types.Float4, tint))
        preview.GetInput("diffuseColor").ConnectToSource(shown, "rgb")
        if surface.blended:
            preview.CreateInput("opacity", types.Float).ConnectToSource(shown, "a")
    if surface.normals is not None:
        spread = {"scale": (types.Float4, Gf.Vec4f(2, 2, 2, 1)), "bias": (types.Float4, Gf.Vec4f(-1, -1, -1, 0))}
        relief = texture(surface.normals, surface.normal_repeats, "raw", **spread)
        preview.CreateInput("normal", types.Normal3f).ConnectToSource(relief, "rgb")
    return material


def _as_identifiers(names: Sequence[str]) -> list[str]:
    """Names as USD allows, letters, digits and underscores, no digit first; of those that would be the same, all but
    the first with a number behind."""
    found: list[str] = []
    for name in names:
        plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
        plain = plain if plain and not plain[0].isdigit() else f"_{plain}"
        alike = (f"{plain}_{k}" for k in itertools.count(2))
        found.append(plain if plain not in found else next(each for each in alike if each not in found))
    return found
