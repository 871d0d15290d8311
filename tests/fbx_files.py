"""FBX 7.4 files as exporters write them, text and binary: a tree of records, and a skinned, animated figure as one.

Dimensions: `V` vertices, `f` polygons, `j` joints, `K` influences, `T` frames.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

__all__ = ["FbxFigure", "Record", "write_fbx"]

TICKS = 46_186_158_000
"""A second of FBX's time."""
ARRAY_CODES = {"float64": b"d", "float32": b"f", "int32": b"i", "int64": b"l"}


@dataclass
class Record:
    """values: whole numbers, floats, texts, `Name`s, bytes, or one array, which the text has in a block of its own."""

    name: str
    values: tuple = ()
    children: list[Record] = field(default_factory=list)


class Name(str):
    """`Class::name` as text has it; binary files have it the other way round."""


class Long(int):
    """A whole number of 64 bits: numbers of objects, and times."""


def write_fbx(path: Path, records: list[Record], *, binary: bool = False) -> None:
    """Write a file. binary: with deflated arrays, as most tools do."""
    if not binary:
        path.write_text("; FBX 7.4.0 project file\n" + "".join(map(_text, records)), encoding="utf-8")
        return
    content = bytearray(b"Kaydara FBX Binary  \0\x1a\0" + struct.pack("<I", 7400))
    for record in records:
        _append(content, record)
    path.write_bytes(bytes(content) + bytes(13) + bytes(160))


def _text(record: Record, indent: str = "") -> str:
    arrays = [value for value in record.values if isinstance(value, np.ndarray)]
    if arrays:
        numbers = ",".join(map(repr, arrays[0].reshape(-1).tolist()))
        return f"{indent}{record.name}: *{arrays[0].size} {{\n{indent}\ta: {numbers}\n{indent}}}\n"
    words = [f'"{value}"' if isinstance(value, str) else _value(value) for value in record.values]
    if not record.children:
        return f"{indent}{record.name}: {','.join(words)}\n"
    inside = "".join(_text(child, indent + "\t") for child in record.children)
    return f"{indent}{record.name}: {','.join(words)} {{\n{inside}{indent}}}\n"


def _value(value) -> str:
    if isinstance(value, bytes):
        import base64

        return f'"{base64.b64encode(value).decode()}"'
    return repr(value)


def _append(content: bytearray, record: Record) -> None:
    start, values = len(content), b"".join(map(_binary, record.values))
    content += struct.pack("<III", 0, len(record.values), len(values)) + bytes([len(record.name)])
    content += record.name.encode() + values
    for child in record.children:
        _append(content, child)
    if record.children:
        content += bytes(13)
    content[start : start + 4] = struct.pack("<I", len(content))


def _binary(value) -> bytes:
    match value:
        case np.ndarray():
            data = zlib.compress(np.ascontiguousarray(value).tobytes())
            return ARRAY_CODES[value.dtype.name] + struct.pack("<III", value.size, 1, len(data)) + data
        case bytes():
            return b"R" + struct.pack("<I", len(value)) + value
        case Name():
            kind, _, name = value.partition("::")
            text = name.encode() + b"\0\x01" + kind.encode()
            return b"S" + struct.pack("<I", len(text)) + text
        case str():
            return b"S" + struct.pack("<I", len(value.encode())) + value.encode()
        case float():
            return b"D" + struct.pack("<d", value)
        case Long():
            return b"L" + struct.pack("<q", value)
    return b"I" + struct.pack("<i", value)


def _surface(vertices: np.ndarray, polygons: list) -> list[Record]:
    """What a geometry has of a mesh's shape; the last corner of a polygon is negative."""
    corners = [c for face in polygons for c in (*map(int, face[:-1]), ~int(face[-1]))]
    return [
        Record("Vertices", (vertices.reshape(-1),)),
        Record("PolygonVertexIndex", (np.array(corners, dtype=np.int32),)),
        Record("GeometryVersion", (124,)),
    ]


@dataclass
class FbxFigure:
    """A figure in its file's own frame and unit, which tests may change before it is written.

    vertices: (V, 3) as they are bound. polygons: of vertices, of any number of corners. joint_names: (j,).
    joint_parents: (j,). binds: (j, 4, 4) joints' worlds when the mesh was bound. influence_joints, influence_weights:
    (V, K). joint_locals: (j, 4, 4) as the file's nodes stand; None: as bound. clips: (T, j, 4, 4) local transforms by
    name. rate_hz: of the clips.
    mesh_world: (4, 4) of the mesh's node when it was bound; mesh_geometry: translation of its geometric transform.
    shapes: offsets (V, 3), and their weight in percent, by name. pre_rotation: degrees, of all joints.
    colours: of materials by name, and materials: (f,) the number of each polygon's; pictures: file's name and content
    by material, the content None for a picture beside the file; uv: (corners, 2).
    """

    vertices: np.ndarray
    polygons: list
    joint_names: list[str]
    joint_parents: np.ndarray
    binds: np.ndarray
    influence_joints: np.ndarray
    influence_weights: np.ndarray
    joint_locals: np.ndarray | None = None
    clips: Mapping[str, np.ndarray] = field(default_factory=dict)
    rate_hz: float = 30.0
    mesh_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    mesh_geometry: tuple = (0.0, 0.0, 0.0)
    shapes: Mapping[str, tuple[np.ndarray, float]] = field(default_factory=dict)
    pre_rotation: tuple = (0.0, 0.0, 0.0)
    colours: Mapping[str, tuple] = field(default_factory=dict)
    materials: np.ndarray | None = None
    pictures: Mapping[str, tuple[str, bytes | None]] = field(default_factory=dict)
    uv: np.ndarray | None = None
    unit_cm: float = 1.0
    axes: tuple = (1, 1, 2, 1, 0, 1)
    """Up, front and right axis, each with its sign."""
    with_skin: bool = True
    visible: bool = True
    lasts: float | None = None
    """[s] that takes say they last; None: as their keys do."""
    props: Mapping[str, tuple[np.ndarray, list, int]] = field(default_factory=dict)
    """Meshes without a skin: vertices as they are bound, polygons, and the joint that each hangs on, -1 for none."""
    untimed: Collection[str] = ()
    """Clips whose takes do not say that they begin at 0."""

    def records(self) -> list[Record]:
        """The file."""
        self._objects, self._links, self._number = [], [], 1000
        self._limbs = [self._limb(joint) for joint in range(len(self.joint_names))]
        for limb, parent in zip(self._limbs, self.joint_parents):
            self._link(limb, self._limbs[parent] if parent >= 0 else 0)
        if len(self.vertices):
            self._mesh()
        for name, (vertices, polygons, joint) in self.props.items():
            world = self.binds[joint] if joint >= 0 else np.eye(4)
            own = (vertices - world[:3, 3]) @ np.linalg.inv(world[:3, :3]).T
            geometry = self._add("Geometry", f"Geometry::{name}", "Mesh", *_surface(own, polygons))
            model = self._add("Model", f"Model::{name}", "Mesh", self._transform(np.eye(4), pre=False))
            self._link(geometry, model)
            self._link(model, self._limbs[joint] if joint >= 0 else 0)
        for name, locals_ in self.clips.items():
            self._clip(name, locals_)
        settings = zip(("Up", "Front", "Coord"), np.reshape(self.axes, (3, 2)).tolist())
        settings = [(f"{name}Axis{end}", value) for name, pair in settings for end, value in zip(("", "Sign"), pair)]
        properties = [Record("P", (name, "int", "Integer", "", value)) for name, value in settings]
        properties += [Record("P", ("UnitScaleFactor", "double", "Number", "", float(self.unit_cm)))]
        properties += [Record("P", ("CustomFrameRate", "double", "Number", "", self.rate_hz))]
        properties += [Record("P", ("TimeMode", "enum", "", "", 14))]
        return [
            Record("FBXHeaderExtension", (), [Record("FBXHeaderVersion", (1003,)), Record("FBXVersion", (7400,))]),
            Record("GlobalSettings", (), [Record("Version", (1000,)), Record("Properties70", (), properties)]),
            Record("Objects", (), self._objects),
            Record("Connections", (), self._links),
        ]

    def _add(self, kind: str, called: str, what: str, *children: Record) -> int:
        self._number += 1
        self._objects.append(Record(kind, (Long(self._number), Name(called), what), list(children)))
        return self._number

    def _link(self, child: int, parent: int, prop: str = "") -> None:
        ends = Long(child), Long(parent)
        self._links.append(Record("C", ("OP", *ends, prop) if prop else ("OO", *ends)))

    def _limb(self, joint: int) -> int:
        local = self.locals_as_bound()[joint] if self.joint_locals is None else self.joint_locals[joint]
        name = self.joint_names[joint]
        limb = self._add("Model", f"Model::{name}", "LimbNode", Record("Version", (232,)), self._transform(local))
        attribute = Record("TypeFlags", ("Skeleton",))
        self._link(self._add("NodeAttribute", f"NodeAttribute::{name}", "LimbNode", attribute), limb)
        return limb

    def locals_as_bound(self) -> np.ndarray:
        """(j, 4, 4) of each joint to its parent."""
        above = [np.eye(4) if parent < 0 else self.binds[parent] for parent in self.joint_parents]
        return np.linalg.inv(above) @ self.binds

    def _transform(self, local: np.ndarray, *, geometry: tuple = (0.0, 0.0, 0.0), pre: bool = True) -> Record:
        scale = np.linalg.norm(local[:3, :3], axis=0)
        angles = self._angles((local[:3, :3] / scale)[None], pre)[0]
        rows = {"Lcl Translation": local[:3, 3], "Lcl Rotation": angles, "Lcl Scaling": scale}
        records = [Record("P", (name, name, "", "A", *map(float, row))) for name, row in rows.items()]
        rows = {"PreRotation": self.pre_rotation if pre else (0, 0, 0), "GeometricTranslation": geometry}
        records += [Record("P", (name, "Vector3D", "Vector", "", *map(float, row))) for name, row in rows.items()]
        return Record("Properties70", (), [*records, Record("P", ("RotationActive", "bool", "", "", 1))])

    def _angles(self, matrices: np.ndarray, pre: bool = True) -> np.ndarray:
        before = Rotation.from_euler("xyz", self.pre_rotation if pre else (0, 0, 0), degrees=True)
        return (before.inv() * Rotation.from_matrix(matrices)).as_euler("xyz", degrees=True)

    def _mesh(self) -> None:
        to_mesh = np.linalg.inv(self.mesh_world)
        own = self.vertices @ to_mesh[:3, :3].T + to_mesh[:3, 3] - self.mesh_geometry
        parts = _surface(own, self.polygons)
        if self.uv is not None:
            head = [Record("Name", ("map1",)), Record("MappingInformationType", ("ByPolygonVertex",))]
            head += [Record("ReferenceInformationType", ("Direct",)), Record("UV", (self.uv.reshape(-1),))]
            parts.append(Record("LayerElementUV", (0,), head))
        if self.materials is not None:
            head = [Record("MappingInformationType", ("ByPolygon",))]
            head += [Record("ReferenceInformationType", ("IndexToDirect",))]
            parts.append(
                Record("LayerElementMaterial", (0,), [*head, Record("Materials", (self.materials.astype(np.int32),))])
            )
        geometry = self._add("Geometry", "Geometry::body", "Mesh", *parts)
        properties = self._transform(self.mesh_world, geometry=self.mesh_geometry, pre=False)
        properties.children.append(Record("P", ("Visibility", "Visibility", "", "A", float(self.visible))))
        model = self._add("Model", "Model::body", "Mesh", properties)
        self._link(geometry, model)
        self._link(model, 0)
        for name, colour in self.colours.items():
            colours = Record("P", ("DiffuseColor", "Color", "", "A", *map(float, colour)))
            material = self._add(
                "Material",
                f"Material::{name}",
                "",
                Record("ShadingModel", ("lambert",)),
                Record("Properties70", (), [colours]),
            )
            self._link(material, model)
            if name in self.pictures:
                self._picture(material, *self.pictures[name])
        if self.with_skin:
            self._skin(geometry)
        if self.shapes:
            self._blend(geometry)

    def _picture(self, material: int, file: str, content: bytes | None) -> None:
        names = [Record("FileName", (f"C:\\textures\\{file}",)), Record("RelativeFilename", (file,))]
        texture = self._add("Texture", f"Texture::{file}", "", *names)
        held = [] if content is None else [Record("Content", (content,))]
        video = self._add("Video", f"Video::{file}", "Clip", *names, *held)
        self._link(texture, material, "DiffuseColor")
        self._link(video, texture)

    def _skin(self, geometry: int) -> None:
        skin = self._add("Deformer", "Deformer::", "Skin", Record("Version", (101,)))
        self._link(skin, geometry)
        for joint, limb in enumerate(self._limbs):
            vertices, at = np.nonzero((self.influence_joints == joint) & (self.influence_weights > 0))
            if not len(vertices):
                continue
            to_bone = np.linalg.inv(self.binds[joint]) @ self.mesh_world
            cluster = self._add(
                "Deformer",
                f"SubDeformer::{self.joint_names[joint]}",
                "Cluster",
                Record("Version", (100,)),
                Record("Indexes", (vertices.astype(np.int32),)),
                Record("Weights", (self.influence_weights[vertices, at].astype(np.float64),)),
                Record("Transform", (to_bone.T.reshape(-1),)),
                Record("TransformLink", (self.binds[joint].T.reshape(-1),)),
            )
            self._link(cluster, skin)
            self._link(limb, cluster)

    def _blend(self, geometry: int) -> None:
        blend = self._add("Deformer", "Deformer::", "BlendShape", Record("Version", (100,)))
        self._link(blend, geometry)
        for name, (offsets, percent) in self.shapes.items():
            moved = np.flatnonzero(np.abs(offsets).max(axis=1) > 0)
            channel = self._add(
                "Deformer",
                f"SubDeformer::{name}",
                "BlendShapeChannel",
                Record("DeformPercent", (float(percent),)),
                Record("FullWeights", (np.array([100.0]),)),
            )
            shape = self._add(
                "Geometry",
                f"Geometry::{name}",
                "Shape",
                Record("Version", (100,)),
                Record("Indexes", (moved.astype(np.int32),)),
                Record("Vertices", (offsets[moved].reshape(-1),)),
            )
            self._link(channel, blend)
            self._link(shape, channel)

    def _clip(self, name: str, locals_: np.ndarray) -> None:
        last = round(((len(locals_) - 1) / self.rate_hz if self.lasts is None else self.lasts) * TICKS)
        span = {"LocalStop": last} if name in self.untimed else {"LocalStart": 0, "LocalStop": last}
        span = [Record("P", (end, "KTime", "Time", "", Long(time))) for end, time in span.items()]
        stack = self._add("AnimationStack", f"AnimStack::{name}", "", Record("Properties70", (), span))
        layer = self._add("AnimationLayer", "AnimLayer::BaseLayer", "")
        self._link(layer, stack)
        times = np.round(np.arange(len(locals_)) / self.rate_hz * TICKS).astype(np.int64)
        for joint, limb in enumerate(self._limbs):
            local = locals_[:, joint]
            angles = np.unwrap(
                self._angles(local[:, :3, :3] / np.linalg.norm(local[:, :3, :3], axis=1)[:, None]), axis=0, period=360
            )
            for prop, values in (("Lcl Rotation", angles), ("Lcl Translation", local[:, :3, 3])):
                if np.ptp(values, axis=0).max() < 1e-9 and joint:
                    continue
                node = self._add("AnimationCurveNode", f"AnimCurveNode::{prop[4]}", "")
                self._link(node, layer)
                self._link(node, limb, prop)
                for axis, column in zip("XYZ", values.T):
                    curve = self._add(
                        "AnimationCurve",
                        "AnimCurve::",
                        "",
                        Record("Default", (float(column[0]),)),
                        Record("KeyVer", (4009,)),
                        Record("KeyTime", (times,)),
                        Record("KeyValueFloat", (column.astype(np.float32),)),
                        Record("KeyAttrFlags", (np.array([4], dtype=np.int32),)),
                        Record("KeyAttrDataFloat", (np.zeros(4, dtype=np.float32),)),
                        Record("KeyAttrRefCount", (np.array([len(times)], dtype=np.int32),)),
                    )
                    self._link(curve, node, f"d|{axis}")
