"""Quality figures of outfits on held-out bodies in motion: what shows through, and what order costs the cloth.

Short runs of neighbouring frames are spread over each clip. Strain and what is seen are of a run's last frame, jitter
of all. Whole garments (`hide_covered=False`) say what shows through; what an outfit gives by default says what holes
that leaves, how much its cloth is strained and how it jitters.

Dimensions: `n` vertices of a garment, `d` degrees of freedom, `T` frames of a run. Metres, root frame.
"""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.check.sight import Cameras, Figure, Surface, holes, what_shows, who_covers
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.motion import Motion
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import edge_strains, jitter
from physkin_core.runtime.layer import WornGarment
from physkin_training.evaluate.evaluate import counting_line, measured_clips
from physkin_training.sampling.chosen_bodies import bodies_by_girth

__all__ = ["RUN", "evaluate_outfits", "parse_outfit"]

RUN, STRIDE = 5, 60
"""Neighbouring frames of a run: three second differences; and frames at 60 Hz from the start of one to the next."""
LEAD = 8
"""Frames before each run, which are draped and not measured: what is kept from frame to frame is then as in playing."""


def parse_outfit(text: str) -> list[WornGarment]:
    """Garments from the skin outwards, as `tshirt:tucked,trousers` names shipped or other models. Raises ValueError for
    less than two, and as `load_garment_model` does."""
    garments = []
    for part in text.split(","):
        name = part.removesuffix(":tucked")
        garments.append(WornGarment(load_garment_model(name), tucked=name != part))
    if len(garments) < 2:
        raise ValueError(f"--outfit {text}: an outfit that is measured has at least two garments, got {len(garments)}")
    return garments


Counts = defaultdict[tuple, list]
"""What is counted of an outfit, over bodies and frames: ("strain" or "jitter", garment, "worn" or "alone"),
("hidden",) [%], ("holes",), ("cloth",) [pixels], and of each pair of surfaces (0 is the skin, layers are numbered from
1) ("shows" or "pixels", inner, outer)."""


def _figures(counts: Counts, names: Sequence[str]) -> dict:
    """See `evaluate_outfits`."""

    def mean(*key) -> float:
        return float(np.mean(counts[key]))

    def shows(*pairs: tuple[int, int]) -> float:
        shown, pixels = (sum(sum(counts[of, *pair]) for pair in pairs) for of in ("shows", "pixels"))
        return 100 * shown / max(pixels, 1)

    garments = {
        name: {
            "strain_percent": mean("strain", name, "worn"),
            "added_strain_points": mean("strain", name, "worn") - mean("strain", name, "alone"),
            "jitter_mm": 1000 * mean("jitter", name, "worn"),
            "added_jitter_ratio": mean("jitter", name, "worn") / mean("jitter", name, "alone"),
        }
        for name in names
    }
    layers = range(1, len(names) + 1)
    pairs = list(combinations(layers, 2))
    return {
        "shows_through_percent": shows(*pairs),
        "skin_shows_percent": shows(*((0, layer) for layer in layers)),
        "hole_percent": 100 * sum(counts["holes",]) / max(sum(counts["cloth",]), 1),
        "added_strain_points": max(garment["added_strain_points"] for garment in garments.values()),
        "added_jitter_ratio": max(garment["added_jitter_ratio"] for garment in garments.values()),
        "hidden_vertices_percent": mean("hidden"),
        "pairs": {f"{names[i - 1]},{names[o - 1]}": shows((i, o)) for i, o in pairs},
        "garments": garments,
    }


class DressedBody:
    """An outfit on one body: whole, as given by default, and each garment alone."""

    def __init__(self, garments: Sequence[WornGarment], avatar: Avatar) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AvatarWarning)
            self.whole, self.given = (Outfit(garments, avatar, hide_covered=hide) for hide in (False, True))
            self.alone = [Draper(garment.model, avatar) for garment in garments]
        rest = self.whole.rig.rest
        surfaces = self._surfaces(rest, self.whole.drape(rest))
        pairs = combinations(range(len(surfaces)), 2)
        self.covers = {(i, o): who_covers(surfaces[i], surfaces[o]) for i, o in pairs}
        self.edges = []
        for draper, layer in zip(self.alone, self.given.layers):
            among = np.zeros(len(layer.hidden), dtype=bool)
            among[layer.visible] = True
            self.edges.append(among[draper.rest_garment.edges].all(axis=1))

    def _surfaces(self, positions: np.ndarray, whole: Sequence[np.ndarray]) -> list[Surface]:
        """Skin and whole layers as they are draped."""
        avatar = self.given.avatar
        skin = Surface(avatar.posed_vertices(self.given.bone_transforms(positions)), avatar.faces)
        layers = zip(whole, self.whole.layers)
        return [skin, *(Surface(cloud[:, :3].copy(), layer.faces, layer.hem_distance) for cloud, layer in layers)]

    def count_run(self, positions: np.ndarray, gravity: np.ndarray, lead: int, counts: Counts) -> None:
        """Count a run in: positions (lead + T, d), gravity (lead + T, 3)."""
        frames, whole = [], []
        for q, down in zip(positions, gravity):
            frames.append(self.given.drape(q, down))
            whole = self.whole.drape(q, down)
        for k, (draper, layer) in enumerate(zip(self.alone, self.given.layers)):
            worn = np.stack([frame[k][:, :3] for frame in frames[lead:]]).astype(np.float64)
            alone = np.stack(draper.layer.drape(zip(positions[lead:], gravity[lead:])))[:, :, :3].astype(np.float64)
            full = alone[-1].copy()
            full[layer.visible] = worn[-1]
            counts["jitter", layer.name, "worn"].append(jitter(worn))
            counts["jitter", layer.name, "alone"].append(jitter(alone[:, layer.visible]))
            for how, each, vertices in (("worn", layer, full), ("alone", draper, alone[-1])):
                strains = edge_strains(each.rest_garment, vertices)
                counts["strain", layer.name, how].append(float(strains[self.edges[k]].mean()))
        counts["hidden",].append(float(100 * np.concatenate([layer.hidden for layer in self.given.layers]).mean()))
        self.count_seen(self._surfaces(positions[-1], whole), frames[-1], counts)

    def count_seen(self, surfaces: list[Surface], given: Sequence[np.ndarray], counts: Counts) -> None:
        """Count in what cameras see of a frame: skin and whole layers, and the clouds given in their place."""
        skin, *cloth = surfaces
        cameras = Cameras(np.concatenate([surface.vertices for surface in cloth]))
        whole = Figure(surfaces, cameras)
        left = [Surface(skin.vertices, skin.faces[~self.given.body_mask])]
        left += [Surface(cloud[:, :3], layer.faces) for cloud, layer in zip(given, self.given.layers)]
        counts["holes",].append(int(holes(whole, Figure(left, cameras)).sum()))
        counts["cloth",].append(int((whole.first.surface > 0).sum()))
        for pair, shown in what_shows(whole, self.covers).items():
            counts["shows", *pair].append(shown.shows)
            counts["pixels", *pair].append(shown.pixels)


def evaluate_outfits(
    outfits: dict[str, Sequence[WornGarment]],
    motions: Sequence[Motion],
    *,
    bodies: int = 3,
) -> dict:
    """Figures of outfits by name, as plain data; on a terminal, progress is shown meanwhile.

    bodies: held-out ones, evenly spread from the leanest to the stoutest. An outfit has:
    `shows_through_percent`: of the pixels that should show a garment over another one, those that show the inner one;
    `skin_shows_percent` likewise; `hole_percent` of the cloth's pixels show a hole where cloth or skin is left out;
    `added_strain_points` of mean edge strain and `added_jitter_ratio`, against each garment alone on that body, of the
    garment with the most, over the vertices given; `hidden_vertices_percent` of all;
    `pairs` by INNER,OUTER with the first of these, `garments`, `clips` with all of these; `counts`.
    Raises ValueError for no motion, wrong counts, what cannot be worn, and as `measured_clips` does.
    """
    if not motions:
        raise ValueError("outfits are measured in motion: give at least one clip")
    clips = measured_clips(motions)
    for clip in clips:
        if clip.frame_count < RUN:
            raise ValueError(f"motion {clip.name!r} is too short: a run is {RUN} frames, got {clip.frame_count}")
    body_model = load_body_model()
    held_out = body_model.held_out_bodies[bodies_by_girth(body_model, bodies)]
    runs = {clip.name: range(0, clip.frame_count - RUN + 1, STRIDE) for clip in clips}
    frames = sum(map(len, runs.values()))
    scores: dict = {}
    watch = counting_line("measuring outfits", len(outfits) * bodies * frames)
    for name, garments in outfits.items():
        names = [garment.model.name for garment in garments]
        counted: dict[str, Counts] = {clip.name: defaultdict(list) for clip in clips}
        total: Counts = defaultdict(list)
        for coefficients in held_out:
            dressed = DressedBody(garments, avatar_from_body(body_model, coefficients))
            for clip in clips:
                counts, positions = counted[clip.name], clip.positions_for(garments[0].model.rig)
                for start in runs[clip.name]:
                    led = slice(max(start - LEAD, 0), start + RUN)
                    dressed.count_run(positions[led], clip.gravity[led], start - led.start, counts)
                    watch(1)
        for counts in counted.values():
            for key, values in counts.items():
                total[key] += values
        scores[name] = _figures(total, names)
        scores[name]["clips"] = {clip: _figures(counts, names) for clip, counts in counted.items()}
    counts = {"bodies": bodies, "clips": len(clips), "frames": frames, "stride": STRIDE, "run": RUN}
    return {"outfit": scores, "counts": counts}
