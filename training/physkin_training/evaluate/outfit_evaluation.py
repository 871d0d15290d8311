"""Quality figures of outfits on held-out bodies in motion: what pokes through, shows, and what order costs the cloth.

Short runs of neighbouring frames are spread over each clip. Strain, pokes and pictures are of a run's last frame,
jitter of all. Whole garments (`hide_covered=False`) say what pokes through and which skin shows; what an outfit
gives by default says what holes that leaves, how much its cloth is strained and how it jitters.

Dimensions: `n` vertices of a garment, `d` degrees of freedom, `T` frames of a run. Metres, root frame.
"""

from __future__ import annotations

import warnings
from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch

from physkin_core.avatar.avatar import Avatar, AvatarWarning, avatar_from_body
from physkin_core.avatar.body_model import BodyModel, load_body_model
from physkin_core.model.garment import Garment
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.motion import Motion
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import edge_strains, jitter
from physkin_core.runtime.layer import WornGarment
from physkin_training.evaluate.evaluate import counting_line, measured_clips
from physkin_training.evaluate.layer_pokes import LayerPokes, Surface, bind_layer_pokes, camera_rays, holes, look
from physkin_training.evaluate.skin_shows import SkinShows
from physkin_training.sampling.chosen_bodies import bodies_by_girth
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["RUN", "Counts", "DressedBody", "evaluate_outfits", "parse_outfit"]

RUN = 5
"""Neighbouring frames of a run: three second differences."""
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
"""What is counted of an outfit, over bodies and frames: ("strain" or "jitter", garment, "worn" or "alone"), ("skin",),
("hidden",) [%], ("body holes",), ("cloth pixels",), and of each pair of layers (inner, outer) ("depths", pair): of each
frame, (k,) [m] by which covered inner vertices stand out, and ("seen" or "poking" or "holes", pair) [pixels]."""


def _figures(counts: Counts, names: Sequence[str]) -> dict:
    """See `evaluate_outfits`."""

    def mean(*key) -> float:
        return float(np.mean(counts[key]))

    def of_pairs(*pairs: tuple[int, int]) -> dict[str, float]:
        depths = np.concatenate([frame for pair in pairs for frame in counts["depths", pair]])
        seen, poking, holes = (sum(sum(counts[of, pair]) for pair in pairs) for of in ("seen", "poking", "holes"))
        pixels = max(seen, 1)
        return {
            "poke_percent": float(100 * (depths > 0).mean()) if len(depths) else 0.0,
            "poke_p999_mm": float(1000 * np.quantile(depths, 0.999)) if len(depths) else 0.0,
            "seen_poke_percent": 100 * (poking + holes) / pixels,
            "seen_through_percent": 100 * poking / pixels,
            "seen_hole_percent": 100 * holes / pixels,
            "covered_vertices": len(depths),
            "pixels": seen,
        }

    garments = {
        name: {
            "strain_percent": mean("strain", name, "worn"),
            "strain_alone_percent": mean("strain", name, "alone"),
            "added_strain_points": mean("strain", name, "worn") - mean("strain", name, "alone"),
            "jitter_mm": 1000 * mean("jitter", name, "worn"),
            "added_jitter_ratio": mean("jitter", name, "worn") / mean("jitter", name, "alone"),
        }
        for name in names
    }
    pairs = list(combinations(range(len(names)), 2))
    return of_pairs(*pairs) | {
        "skin_shows_percent": mean("skin"),
        "skin_hole_percent": 100 * sum(counts["body holes",]) / max(sum(counts["cloth pixels",]), 1),
        "added_strain_points": max(garment["added_strain_points"] for garment in garments.values()),
        "added_jitter_ratio": max(garment["added_jitter_ratio"] for garment in garments.values()),
        "hidden_vertices_percent": mean("hidden"),
        "pairs": {",".join(names[k] for k in pair): of_pairs(pair) for pair in pairs},
        "garments": garments,
    }


class DressedBody:
    """An outfit on one body: whole, as given by default, and each garment alone."""

    def __init__(self, garments: Sequence[WornGarment], avatar: Avatar) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AvatarWarning)
            self.whole, self.given = (Outfit(garments, avatar, hide_covered=hide) for hide in (False, True))
            self.alone = [Draper(garment.model, avatar) for garment in garments]
        rest = [cloud[:, :3].astype(np.float64) for cloud in self.whole.drape(self.whole.rig.rest)]
        self.pokes: dict[tuple[int, int], LayerPokes] = {
            (i, o): bind_layer_pokes(rest[i], rest[o], tuple(self.whole.layers[k].faces for k in (i, o)))
            for i, o in combinations(range(len(garments)), 2)
        }
        self.removed = [layer.bound.faces[layer.hidden[layer.bound.faces].all(axis=1)] for layer in self.given.layers]
        self.edges = []
        for draper, layer in zip(self.alone, self.given.layers):
            among = np.zeros(len(layer.hidden), dtype=bool)
            among[layer.visible] = True
            self.edges.append(among[draper.rest_garment.edges].all(axis=1))

    def count_run(self, positions: np.ndarray, gravity: np.ndarray, lead: int, counts: Counts) -> list:
        """Count a run in: positions (lead + T, d), gravity (lead + T, 3). Returns the last frame's whole garments
        (n, 6)."""
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
        self.count_seen(whole, frames[-1], positions[-1], counts)
        return whole

    def count_seen(self, whole: list, given: list, positions: np.ndarray, counts: Counts) -> None:
        """Count in what eight cameras see of a frame: its clouds of `whole` and of `given`, at positions (d,)."""
        avatar = self.given.avatar
        body = avatar.posed_vertices(self.given.bone_transforms(positions)).astype(np.float64)
        cloth = [
            Surface(cloud[:, :3].astype(np.float64), layer.faces) for cloud, layer in zip(whole, self.whole.layers)
        ]
        rays = camera_rays(np.concatenate([surface.vertices for surface in cloth]))
        skin = Surface(body, avatar.faces)
        view = look([*cloth, skin], rays)
        mask = self.given.body_mask
        left = [Surface(cloud[:, :3], layer.faces) for cloud, layer in zip(given, self.given.layers)]
        removed = [Surface(surface.vertices, faces) for surface, faces in zip(cloth, self.removed)]
        left.append(Surface(body, skin.faces[~mask]))
        removed.append(Surface(body, skin.faces[mask]))
        missed = holes(left, removed, rays)
        counts["body holes",].append(int((missed.surface == len(cloth)).sum()))
        counts["cloth pixels",].append(int(((view.surface >= 0) & (view.surface < len(cloth))).sum()))
        for (i, o), pokes in self.pokes.items():
            inner, outer = cloth[i].vertices, cloth[o].vertices
            normals = whole[i][:, 3:].astype(np.float64)
            counts["depths", (i, o)].append(pokes.depths(inner[pokes.covered], normals[pokes.covered], outer))
            only = view if len(cloth) == 2 else look([cloth[i], cloth[o], skin], rays)
            under = (only.surface == 0) & only.facing
            under[under] = pokes.covered[pokes.faces[0][only.face[under]]].all(axis=1)
            over = (only.surface == 1) & only.facing
            over[over] = pokes.covering[pokes.faces[1][only.face[over]]].all(axis=1)
            counts["seen", (i, o)].append(int((under | over).sum()))
            shown = (view.surface == i) & view.facing
            shown[shown] = pokes.covered[pokes.faces[0][view.face[shown]]].all(axis=1)
            points, outward = _surface_points(inner, normals, pokes.faces[0][view.face[shown]], view.share[shown])
            counts["poking", (i, o)].append(int((pokes.depths(points, outward, outer) > 0).sum()))
            hole = missed.surface == i
            points, outward = _surface_points(inner, normals, self.removed[i][missed.face[hole]], missed.share[hole])
            would_poke = pokes.depths(points, outward, outer) > 0  # and is not missed
            counts["holes", (i, o)].append(int((~would_poke).sum()))


def _surface_points(vertices: np.ndarray, normals: np.ndarray, corners: np.ndarray, share: np.ndarray):
    """Points and normals, both (k, 3), at shares (k, 3) of corners (k, 3) among vertices and normals (n, 3)."""
    return tuple(np.einsum("kj,kji->ki", share, values[corners]) for values in (vertices, normals))


def evaluate_outfits(
    outfits: dict[str, Sequence[WornGarment]],
    motions: Sequence[Motion],
    device: torch.device,
    *,
    bodies: int = 3,
    stride: int = 60,
    body_model: BodyModel | None = None,
) -> dict:
    """Figures of outfits by name, as plain data; on a terminal, progress is shown meanwhile.

    bodies: held-out ones, evenly spread from the leanest to the stoutest. stride: frames at 60 Hz from the start of one
    run to the next. An outfit has:
    `poke_percent` of inner vertices that the outer garment covers at rest stand out of it, seen or not; `poke_p999_mm`,
    the 99.9th percentile of how far, 0 inside;
    `seen_poke_percent` of the pixels of the covered region, from eight sides: `seen_through_percent` shows the inner
    garment outside the outer one in whole garments, `seen_hole_percent` a hole where inner cloth is left out;
    `skin_shows_percent` as of a garment, of all cloth together; `skin_hole_percent` of the cloth's pixels show a hole
    where skin is left out; `added_strain_points` of mean edge strain and `added_jitter_ratio`, against each garment
    alone on that body, of the garment with the most, over the vertices given; `hidden_vertices_percent` of all;
    `pairs` by INNER,OUTER with the first six, `garments`, `clips` with all of these; `counts`.
    Raises ValueError for no motion, wrong counts, what cannot be worn, and as `measured_clips` does.
    """
    if not motions:
        raise ValueError("outfits are measured in motion: give at least one clip")
    if stride < RUN:
        raise ValueError(f"stride must be at least {RUN} frames, the length of a run, got {stride}")
    clips = measured_clips(motions)
    for clip in clips:
        if clip.frame_count < RUN:
            raise ValueError(f"motion {clip.name!r} is too short: a run is {RUN} frames, got {clip.frame_count}")
    body_model = body_model or load_body_model()
    held_out = body_model.held_out_bodies[bodies_by_girth(body_model, bodies)]
    runs = {clip.name: range(0, clip.frame_count - RUN + 1, stride) for clip in clips}
    frames = sum(map(len, runs.values()))
    posed = PosedBodies(body_model, BodySet(body_model, held_out, device), 1)
    scores: dict = {}
    watch = counting_line("measuring outfits", len(outfits) * bodies * frames)
    for name, garments in outfits.items():
        skin = SkinShows(_together([garment.model.garment for garment in garments]), body_model, posed)
        names = [garment.model.name for garment in garments]
        counted: dict[str, Counts] = {clip.name: defaultdict(list) for clip in clips}
        total: Counts = defaultdict(list)
        for body, coefficients in enumerate(held_out):
            dressed = DressedBody(garments, avatar_from_body(body_model, coefficients))
            for clip in clips:
                counts, positions = counted[clip.name], clip.positions_for(garments[0].model.rig)
                for start in runs[clip.name]:
                    led = slice(max(start - LEAD, 0), start + RUN)
                    lead = start - led.start
                    whole = dressed.count_run(positions[led], clip.gravity[led], lead, counts)
                    counts["skin",].append(_skin_shows(skin, posed, positions[led][-1], body, whole))
                    watch(1)
        for counts in counted.values():
            for key, values in counts.items():
                total[key] += values
        scores[name] = _figures(total, names)
        scores[name]["clips"] = {clip: _figures(counts, names) for clip, counts in counted.items()}
    counts = {"bodies": bodies, "clips": len(clips), "frames": frames, "stride": stride, "run": RUN}
    return {"outfit": scores, "counts": counts}


def _together(garments: Sequence[Garment]) -> Garment:
    """All garments as one mesh."""
    first = np.cumsum([0, *(len(garment.vertices) for garment in garments)])
    faces = [garment.faces + start for garment, start in zip(garments, first)]
    return Garment(np.concatenate([garment.vertices for garment in garments]), np.concatenate(faces))


def _skin_shows(skin: SkinShows, posed: PosedBodies, positions: np.ndarray, body: int, cloth: list) -> float:
    device = posed.offset.device
    posed.pose(
        torch.as_tensor(positions[None], dtype=torch.float32, device=device), torch.tensor([body], device=device)
    )
    vertices = np.concatenate([cloud[:, :3] for cloud in cloth])[None]
    figures = skin.figures(torch.as_tensor(vertices, dtype=torch.float32, device=device), skin.overlapped())
    return float(figures["skin_shows_percent"])
