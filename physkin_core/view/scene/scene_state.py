"""What the page shows, without the page: who wears what, in which pose, and the frame that follows from it.

Dimensions: `d` degrees of freedom, `V` body vertices, `v` vertices given of a garment, `m` garment nodes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock, RLock
from time import perf_counter

import numpy as np

from physkin_core.avatar.loading import BUNDLED_AVATAR
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.loader.requests import GarmentRequest, OutfitRequest
from physkin_core.look.cloth_look import cloth_colours
from physkin_core.model.model_file import split_fabric
from physkin_core.motion.motion import Motion
from physkin_core.outfit.coverage import OwnClothes
from physkin_core.outfit.outfit import Outfit
from physkin_core.outfit.outfit_options import named_garments
from physkin_core.pictures.picture import BODY_COLOUR
from physkin_core.points.point_files import splat_colours
from physkin_core.points.splat_draper import SplatSkinner
from physkin_core.points.splats import Splats
from physkin_core.runtime.bound_garment import plain_skinning
from physkin_core.separation.limb_separator import LimbSeparator
from physkin_core.view.scene.heat_map import Colour
from physkin_core.view.scene.motion_player import MotionPlayer, Pose, standing_pose

__all__ = ["Frame", "SceneState", "SplatFrame"]

TIMED_FRAMES = 60
"""Frames whose times the read-out is the median of."""
SETTLES_WITHIN = 3.0
"""[s] after a motion has paused, cloth that sways hangs still."""


@dataclass(frozen=True)
class SplatFrame:
    """Gaussian splats that are drawn in place of garment number `garment`, in the root frame. colours: (n, 3) sRGB in
    [0, 1], None for the garment's. opacity: (n,) in [0, 1]."""

    splats: Splats
    garment: int
    colours: np.ndarray | None
    opacity: np.ndarray


@dataclass(frozen=True)
class Frame:
    """One pose of the avatar and what it wears, in the root frame [m].

    outfit: what is worn. pose: of the body, with its place in the world. body: (V, 3) float32. cloth: (v, 6) float32 of
    each garment, positions and normals, overwritten by the next frame. plain: (v, 3) of each garment by plain skinning,
    where asked for. nodes: (m, 3) garment nodes of each garment. splats: of one of them, if any. colours: of the body
    and each garment. own_colours: (F, 3) sRGB of the body's faces by its own materials, where it has any. microseconds:
    what draping takes, the median of the last frames.
    """

    outfit: Outfit
    pose: Pose
    body: np.ndarray
    cloth: tuple[np.ndarray, ...]
    plain: tuple[np.ndarray, ...]
    nodes: tuple[np.ndarray, ...]
    splats: SplatFrame | None
    colours: tuple[Colour, ...]
    own_colours: np.ndarray | None
    microseconds: float


class SceneState:
    """Changed from any thread, drawn by one: `advance` gives the frames.

    loader: of all files. garments: names of shipped models or files, from the skin outwards; tucked: those of them
    whose hem is under the next one's waistband. body: an avatar file; rig_file: of one without a skin. motion: as
    `load_motion` takes it, or None; source_rate_hz: of that file; bones: of it and of the body. fit, own_clothes: as of
    `Outfit`. points: a file of splats where one of the garments lies; while that is worn, frames have them; has_splats:
    whether there is one. separate_limbs: whether poses go through a `LimbSeparator`.
    warnings: of what is worn, and of limbs that are not separated. rig: whose joints there are. playing, speed: of the
    motion; seconds: its time. sway: as of `Outfit`. wind: [m/s] along the world's X axis, changed by `blow`. pose:
    shown now; posed_by_hand: whether a joint was set last. show_plain: compute plain skinning too.
    Raises what loading raises; what is shown is then as it was.
    """

    def __init__(
        self,
        loader: AssetLoader,
        garments: Sequence[str],
        *,
        tucked: Sequence[str] = (),
        body: str | Path = BUNDLED_AVATAR,
        rig_file: str | Path | None = None,
        bones: str | Path | None = None,
        motion: str | Path | None = None,
        source_rate_hz: float | None = None,
        fit: float | None = None,
        own_clothes: OwnClothes = "replace",
        points: str | Path | None = None,
    ) -> None:
        self._loader, self._points, self._fit, self._own_clothes = loader, points, fit, own_clothes
        self.has_splats = points is not None
        self._bones = {} if bones is None else {str(body): str(bones)}
        self._motion_settings = {str(motion): {"bones": bones, "source_rate_hz": source_rate_hz}}
        self._binding, self._lock = Lock(), RLock()
        self._changed = True
        self._player: MotionPlayer | None = None
        self.playing, self.speed, self.seconds = False, 1.0, 0.0
        self.sway, self.wind = 1.0, 0.0
        self._clock = self._settling = 0.0
        self.posed_by_hand = False
        self.show_plain = False
        self.body_colour: Colour = BODY_COLOUR
        self._chosen_colours: dict[str, Colour] = {}
        self.garments: tuple[str, ...] = ()
        self.tucked: frozenset[str] = frozenset()
        self.body, self.rig_file, self.separate_limbs = Path(body), rig_file, False
        self.outfit: Outfit | None = None
        self.wear(garments, tucked=tucked)
        if motion is not None:
            self.choose_motion(motion)
            self.play()

    # --- Who wears what: takes a second or two ---

    def wear(
        self,
        garments: Sequence[str] | None = None,
        *,
        tucked: Collection[str] = (),
        body: str | Path | None = None,
        rig_file: str | Path | None = None,
        separate_limbs: bool | None = None,
    ) -> None:
        """Put on other garments, or the same on another body, or on one whose limbs are separated before draping, or
        no longer. What is not given stays; tucked goes with garments, rig_file with body."""
        with self._binding:
            if garments is None:
                garments, tucked = self.garments, self.tucked
            if body is None:
                body, rig_file = self.body, self.rig_file
            limbs = self.separate_limbs if separate_limbs is None else separate_limbs
            self._dress(garments, tucked, Path(body), rig_file, limbs)

    def _dress(self, garments, tucked, body, rig_file, separate_limbs) -> None:
        if not garments:
            raise ValueError("nothing to wear: choose at least one garment")
        named = named_garments(garments, sorted(tucked))
        request = OutfitRequest(
            tuple(GarmentRequest(name, tucked=is_tucked, fit=self._fit) for name, is_tucked in named),
            str(body),
            str(rig_file or ""),
            self._bones.get(str(body), ""),
            own_clothes=self._own_clothes,
            limbs=separate_limbs,
            points=str(self._points or ""),
            colours=True,
        )
        outfit, loaded = self._loader.outfit(request)
        if loaded.splats_refused and self.outfit is None:  # later, the garment that they lie on has been taken off
            raise ValueError(loaded.splats_refused)
        rig, avatar = outfit.rig, outfit.avatar
        player = None if self._player is None else MotionPlayer(self._player.motion, rig, avatar)
        separator = None if loaded.limbs is None else LimbSeparator.from_bound(loaded.limbs)
        splats = None
        if loaded.splats is not None:
            skinner = SplatSkinner(loaded.splats.bound)
            splats = loaded.splats.garment, skinner, splat_colours(loaded.splats.look, skinner.splat_count)
        with self._lock:
            posed = self.outfit is not None and self.rig.joint_names == rig.joint_names
            positions = self.pose.positions if posed else rig.rest
            self.garments, self.tucked = tuple(garments), frozenset(tucked)
            self.body, self.rig_file, self.separate_limbs = body, rig_file, separate_limbs
            self.rig, self._player, self.outfit = rig, player, outfit
            self._splats, self._separator, self._own_colours = splats, separator, loaded.colours
            self.warnings = outfit.warnings + (() if separator is None else separator.warnings)
            self.pose = standing_pose(positions, avatar) if player is None else player.pose(self.seconds)
            self._cloth = tuple(np.zeros((layer.vertex_count, 6), dtype=np.float32) for layer in outfit.layers)
            self._times: deque[float] = deque(maxlen=TIMED_FRAMES)
            self._changed = True

    @property
    def cloth_colours(self) -> tuple[Colour, ...]:
        """Of each garment, sRGB in [0, 1]: chosen, or by its fabric and its place in the outfit."""
        usual = cloth_colours(self.outfit.garments)
        return tuple(self._chosen_colours.get(file, colour) for file, colour in zip(self._files, usual))

    @property
    def _files(self) -> list[str]:
        """Of the garments, whatever fabric they are of."""
        return [split_fabric(name)[0] for name in self.garments]

    def recolour(self, *, body: Colour, cloth: Sequence[Colour]) -> None:
        """Choose colours of the body and of each garment worn."""
        with self._lock:
            self.body_colour = body
            changed = [k for k, (old, new) in enumerate(zip(self.cloth_colours, cloth)) if old != new]
            self._chosen_colours |= {self._files[k]: cloth[k] for k in changed}
            self._changed = True

    # --- In which pose ---

    @property
    def motion(self) -> Motion | None:
        """What is played, if anything."""
        return None if self._player is None else self._player.motion

    @property
    def duration(self) -> float:
        """Of the motion [s]; 0 without one."""
        return 0.0 if self._player is None else self._player.duration

    def choose_motion(self, motion: str | Path | None) -> None:
        """Show a motion from its start, or, with None, a pose that joints are set to, upright where the body stands."""
        loaded = None if motion is None else self._loader.motion(motion, **self._motion_settings.get(str(motion), {}))
        with self._lock:
            self._player = None if loaded is None else MotionPlayer(loaded, self.rig, self.outfit.avatar)
            if self._player is None:
                self.playing = False
                self.pose = standing_pose(self.pose.positions, self.outfit.avatar)
                self._changed = True
            else:
                self.scrub(0.0)

    def play(self) -> None:
        """Go on with the motion. Raises ValueError when there is none."""
        if self._player is None:
            raise ValueError("nothing to play: choose a motion")
        self.playing = True

    def pause(self) -> None:
        """Keep the pose."""
        self.playing = False

    def scrub(self, seconds: float) -> None:
        """Show the motion at a time [s] from its start."""
        with self._lock:
            if self._player is not None:
                self.seconds = min(max(float(seconds), 0.0), self.duration)
                self.pose = self._player.pose(self.seconds)
                self.posed_by_hand, self._changed = False, True

    def set_joint(self, joint: int, position: float) -> None:
        """Turn one joint to a position [rad], within its limits; a motion pauses."""
        with self._lock:
            self.playing, self.posed_by_hand = False, True
            positions = self.pose.positions.copy()
            positions[joint] = np.clip(position, self.rig.lower[joint], self.rig.upper[joint])
            self.pose = Pose(positions, self.pose.root_orientation, self.pose.root_position)
            self._changed = True

    def rest(self) -> None:
        """The canonical pose, upright; a motion pauses."""
        with self._lock:
            self.playing = self.posed_by_hand = False
            self.pose = standing_pose(self.rig.rest, self.outfit.avatar)
            self._changed = True

    def redraw(self) -> None:
        """Let `advance` give a frame, though no pose has changed."""
        self._changed = True

    def blow(self, wind: float) -> None:
        """Let wind blow along the world's X axis [m/s], against it below 0; cloth follows though the motion stands."""
        self.wind, self._settling, self._changed = wind, SETTLES_WITHIN, True

    # --- The frame ---

    def advance(self, seconds: float) -> Frame | None:
        """What is to be seen after so much more time [s], or None where that is what was given last."""
        with self._lock:
            if self.playing and self._player is not None and self.duration > 0:
                seconds *= self.speed
                self.seconds = (self.seconds + seconds) % self.duration
                self.pose = self._player.pose(self.seconds)
                self.posed_by_hand, self._changed = False, True
                self._settling = SETTLES_WITHIN if self.sway else 0.0
            self._clock += seconds
            if not self._changed and self._settling <= 0:
                return None
            self._settling -= seconds
            self._changed = False
            return self._frame()

    def _frame(self) -> Frame:
        outfit, pose = self.outfit, self.pose
        outfit.sway, outfit.wind = self.sway, (self.wind, 0.0, 0.0)
        root = np.concatenate([pose.root_position, pose.root_orientation])
        began = perf_counter()
        if self._separator is not None:
            pose = replace(pose, positions=self._separator.separate(pose.positions)[0])
        outfit.drape(pose.positions, time=self._clock, root=root, outs=self._cloth)
        self._times.append(1e6 * (perf_counter() - began))
        bones, transforms = outfit.bone_transforms(pose.positions), outfit.node_transforms()
        return Frame(
            outfit=outfit,
            pose=pose,
            body=outfit.body_to_draw.posed_vertices(bones),
            cloth=self._cloth,
            plain=tuple(plain_skinning(layer.bound_visible, bones) for layer in outfit.layers)
            if self.show_plain
            else (),
            nodes=tuple(each[..., 3] for each in transforms),
            splats=self._splat_frame(transforms),
            colours=(self.body_colour, *self.cloth_colours),
            own_colours=self._own_colours,
            microseconds=float(np.median(self._times)),
        )

    def _splat_frame(self, node_transforms: tuple[np.ndarray, ...]) -> SplatFrame | None:
        if self._splats is None:
            return None
        garment, skinner, look = self._splats
        splats = skinner.skin(node_transforms[garment], self.outfit.detail_offsets()[garment])
        return SplatFrame(splats, garment, *look)
