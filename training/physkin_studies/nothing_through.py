"""What comes through cloth in motion: skin through cloth that hangs, and one layer through another, frame by frame.

`PYTHONPATH=training:native python -m physkin_studies.nothing_through CLIP ...` plays whole clips at 30 Hz, with sway,
on people and on bodies unlike any of them, and prints a row of a Markdown table for each outfit, body and clip: an hour
for four clips of 20 s. With `--bodies` several processes can share them; it takes avatar files, too. `--sway 0` shows
what is there without sway.

Skin is looked up in every frame (`--every` 1), at all cloth that is more than 2 cm off the skin at rest; layers once a
second, by the eight cameras that measure outfits. Where a body runs into itself, cloth cannot be outside of both parts:
vertices inside two parts at once, and those over skin that is itself inside another part, are told apart. Strain and
jitter are compared with the same garments alone, which nothing keeps out of the skin.

Dimensions: `n` vertices of all garments, `f` faces of the body. Metres.
"""

from __future__ import annotations

import argparse
import warnings
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import load_motion
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit_options import add_options
from physkin_core.quality import edge_strain
from physkin_core.rig.rig import Rig
from physkin_core.runtime.layer import WornGarment
from physkin_studies.fantastical_bodies import KINDS, fantastical_body_model
from physkin_training.evaluate.outfit_evaluation import Counts, DressedBody
from physkin_training.physics.surface_queries import BodySurface
from physkin_training.sampling.chosen_bodies import bodies_by_girth

__all__ = ["BODIES", "HEADS", "OUTFITS", "Row", "avatar_of", "main", "play"]

OUTFITS = ("trousers,tshirt", "skirt,tshirt", "dress", "trousers,longsleeve")
"""Garments from the skin outwards."""
GIRTHS = ("lean", "average", "stout")
BODIES = ("bundled", *GIRTHS, *(kind for kind in KINDS if kind != "extreme"))
"""The shipped avatar, held-out adults, and fantastical bodies that are most unlike them."""
RATE = 30.0
HANGS = 0.02
"""[m] Cloth farther from the skin at rest hangs."""
DEEP = 0.002
"""[m] Cloth deeper inside the skin counts."""
MANY = 3
"""Vertices inside the skin; frames with more are counted."""
OFF_SKIN = 0.001
"""[m] So far off it skin is asked whether it is inside another part of the body."""
STRAIN_EVERY, SEEN_EVERY = 5, 30
"""Frames."""
HEADS = (
    *("outfit", "body", "clip", "frames", "most in skin", "at frame", f"% of frames above {MANY}", "most but arms"),
    *(f"% of frames above {MANY} but arms", "most, body apart", f"% of frames above {MANY}, body apart"),
    *("seen pokes %", "worst frame %", "added strain", "jitter"),
)
"""*Body apart*: but arms, and but where the body runs into itself."""


@dataclass(frozen=True)
class Row:
    """An outfit on a body in a clip.

    inside, but_arms, apart: of each frame looked up, `every` apart, how many vertices that hang are inside the skin;
    inside skin other than that of hands and forearms; and of these, where the body does not run into itself. seen: of
    each frame looked at, pixels that show an inner layer or a hole, and pixels of the
    covered region. added_strain: in points, of the garment that has most; jitter: likewise, as a ratio.
    """

    names: tuple[str, str, str]
    inside: np.ndarray
    but_arms: np.ndarray
    apart: np.ndarray
    seen: np.ndarray
    added_strain: float
    jitter: float
    every: int = 1

    def cells(self) -> list[str]:
        """As in `HEADS`."""
        shares = 100 * self.seen[:, 0] / np.maximum(self.seen[:, 1], 1)
        seen = [100 * self.seen[:, 0].sum() / max(self.seen[:, 1].sum(), 1), shares.max(initial=0.0)]
        return [
            *self.names,
            str(len(self.inside)),
            str(self.inside.max()),
            str(self.every * self.inside.argmax()),
            f"{100 * (self.inside > MANY).mean():.1f}",
            str(self.but_arms.max()),
            f"{100 * (self.but_arms > MANY).mean():.1f}",
            str(self.apart.max()),
            f"{100 * (self.apart > MANY).mean():.1f}",
            *(["", ""] if not len(self.seen) else [f"{share:.3f}" for share in seen]),
            f"{self.added_strain:.2f}",
            f"{self.jitter:.3f}",
        ]


@dataclass
class Moving:
    """What is kept of a garment from frame to frame: its last two drapes, sums of second differences, and strains."""

    last: list[np.ndarray] = field(default_factory=list)
    second: float = 0.0
    strains: list[float] = field(default_factory=list)

    def add(self, vertices: np.ndarray) -> None:
        """The next frame's vertices (n, 3)."""
        if len(self.last) == 2:
            before, now = self.last
            self.second += float(np.linalg.norm(vertices - 2 * now + before, axis=1).mean())
        self.last = [*self.last[-1:], vertices]


class PlayedOutfit:
    """An outfit on one body, in play: with its garments alone, unguarded."""

    def __init__(self, name: str, avatar: Avatar, *, sway: float = 1.0, every: int = 1) -> None:
        self.name, self.every = name, every
        self.dressed = DressedBody([WornGarment(load_garment_model(part)) for part in name.split(",")], avatar)
        self.free = [draper.outfit.with_bound_garment(0, draper.bound.unguarded) for draper in self.dressed.alone]
        rest = self.dressed.whole.drape(self.dressed.whole.rig.rest)
        body = avatar.posed_vertices(self.dressed.whole.bone_transforms(self.dressed.whole.rig.rest))
        closest = BodySurface(body, avatar.faces).closest(np.concatenate(rest)[:, :3])
        self.hanging = closest.distance > HANGS
        self.beneath = avatar.faces[closest.face[self.hanging]], closest.barycentric[self.hanging]
        for outfit in (self.dressed.whole, self.dressed.given, *self.free):
            outfit.sway = sway

    def begin(self) -> None:
        """Before a clip."""
        for outfit in (self.dressed.whole, self.dressed.given, *self.free):
            outfit.reset()
        self.counts: Counts = defaultdict(list)
        self.worn, self.alone = ([Moving() for _ in self.free] for _ in range(2))

    def add(self, frame: int, positions: np.ndarray, moment: dict, body: BodySurface, of_arms: np.ndarray) -> None:
        """A frame. moment: time and root, as `Outfit.drape` takes them. of_arms: (f,) bool, skin of lower arms."""
        dressed = self.dressed
        whole = dressed.whole.drape(positions, **moment)
        given = dressed.given.drape(positions, **moment)
        if frame % self.every == 0:
            self.count_inside(np.concatenate(whole)[self.hanging, :3], body, of_arms)
        if frame % SEEN_EVERY == 0 and len(whole) > 1:
            dressed.count_seen(whole, given, positions, self.counts)
        for k, outfit in enumerate(self.free):
            free = outfit.drape(positions, **moment)[0]
            layers = (dressed.whole.layers[k], dressed.alone[k].layer)
            for moving, cloud, layer in zip((self.worn[k], self.alone[k]), (whole[k], free), layers):
                vertices = cloud[:, :3].astype(np.float64)
                moving.add(vertices)
                if frame % STRAIN_EVERY == 0:
                    moving.strains.append(float(edge_strain(layer.rest_garment, vertices)))

    def count_inside(self, cloth: np.ndarray, body: BodySurface, of_arms: np.ndarray) -> None:
        """Count in what of the cloth that hangs (h, 3) is inside the skin."""
        closest = body.closest(cloth)
        inside = closest.distance < -DEEP
        but_arms = np.flatnonzero(inside & ~of_arms[closest.face])
        corners, shares = (of[but_arms] for of in self.beneath)
        skin, normals = (np.einsum("kj,kji->ki", shares, of[corners]) for of in (body.vertices, body.normals))
        merged = body.surrounds(cloth[but_arms], times=2) | body.surrounds(skin + OFF_SKIN * normals)
        for key, count in (("inside", inside.sum()), ("but arms", len(but_arms)), ("apart", (~merged).sum())):
            self.counts[key,].append(int(count))

    def row(self, body: str, clip: str) -> Row:
        """Of the frames added since `begin`."""
        inside, but_arms, apart = (np.array(self.counts[key,]) for key in ("inside", "but arms", "apart"))
        pairs = self.dressed.pokes
        shown, seen = (
            np.sum([np.sum([self.counts[of, pair] for of in kinds], axis=0) for pair in pairs], axis=0)
            for kinds in (("poking", "holes"), ("seen",))
        )
        return Row(
            (self.name, body, clip),
            inside,
            but_arms,
            apart,
            np.stack([shown, seen], axis=1) if pairs else np.zeros((0, 2)),
            max(float(np.mean(a.strains) - np.mean(b.strains)) for a, b in zip(self.worn, self.alone)),
            max(a.second / max(b.second, 1e-12) for a, b in zip(self.worn, self.alone)),
            self.every,
        )


def avatar_of(body: str) -> Avatar:
    """One of `BODIES`, or a file. Raises AvatarError as `load_avatar`."""
    adults, unlike = load_body_model(), fantastical_body_model()
    if body == "bundled":
        return load_avatar(BUNDLED_AVATAR, adults.rig)
    if body in GIRTHS:
        chosen = bodies_by_girth(adults, len(GIRTHS))[GIRTHS.index(body)]
        return avatar_from_body(adults, adults.held_out_bodies[chosen])
    if body in BODIES:
        return avatar_from_body(unlike, unlike.held_out_bodies[list(KINDS).index(body)])
    return load_avatar(body, adults.rig)


def play(
    outfits: Sequence[str], bodies: Sequence[str], motions: Sequence[Motion], *, sway: float = 1.0, every: int = 1
) -> Iterator[Row]:
    """Rows of each body, clip and outfit, in this order. motions: at `RATE`. sway: as of `Outfit`. every: frames from
    one in which skin is looked up to the next; all are draped."""
    for body in bodies:
        avatar = avatar_of(body)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AvatarWarning)
            played = [PlayedOutfit(outfit, avatar, sway=sway, every=every) for outfit in outfits]
        whole = played[0].dressed.whole
        of_arms = _of_arms(avatar, whole.rig)
        for motion in motions:
            for each in played:
                each.begin()
            for frame, positions in enumerate(motion.positions_for(whole.rig)):
                moment = {"time": motion.times[frame], "root": motion.root[frame]}
                surface = BodySurface(avatar.posed_vertices(whole.bone_transforms(positions)), avatar.faces)
                for each in played:
                    each.add(frame, positions, moment, surface, of_arms)
            yield from (each.row(Path(body).stem, motion.name) for each in played)


def _of_arms(avatar: Avatar, rig: Rig) -> np.ndarray:
    """(f,) bool, the faces of hands and forearms."""
    bones = rig.inherited({limb.ends[1]: 1 for limb in find_limbs(rig).limbs if limb.is_arm}, 0) == 1
    share = (bones[avatar.influence_bones] * avatar.influence_weights).sum(axis=1)
    return share[avatar.faces].mean(axis=1) > 0.5


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the table, a row as it is measured. argv: default the command line's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clips", nargs="+", metavar="CLIP", help="motion files or names of shipped ones")
    parser.add_argument("--bodies", nargs="+", default=BODIES, help=f"of {', '.join(BODIES)}, or avatar files")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="look skin up every N-th frame (default 1)")
    add_options(parser, "sway")
    options = parser.parse_args(argv)
    motions = [load_motion(clip).resampled(RATE) for clip in options.clips]
    for line in (HEADS, ["---"] * len(HEADS)):
        print(f"| {' | '.join(line)} |")
    for row in play(OUTFITS, options.bodies, motions, sway=options.sway, every=options.every):
        print(f"| {' | '.join(row.cells())} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
