"""A probability of skin for each texel, from the scan's own colours.

No learned weights, no face detector: what counts is how skin, hair and eyes colour light. Blood
absorbs green and blue and hardly any red, melanin absorbs all three (Tsumura, Haneishi, Miyake:
Independent-component analysis of skin color image, JOSA A 16(9), 1999). So in the *red* channel
lips, cheeks and ears are as light as the skin around them, and hair is what is darker. Steps:

1. Skin's colour is the heaviest mode of (ln R, ln R/G, ln G/B) among texels that face +Z.
2. The capture's light, fitted to its red by the normal (`bakedlight`), is divided out.
3. Each texel is compared with the skin around it, so that neither a tanned neck nor the rest of the
   light matters. Coverage by hair is linear unmixing: (R_skin - R) / (R_skin - R_hair). What
   occlusion can darken as much, or what is redder than its surroundings, is not hair.
4. What is less red than skin is an eye when it lies beside something dark, cloth when it is large.
5. Islands too thin or too small to be a material (moles, creases, speckles) go; borders are soft.

Limits: cast shadows as dark as hair, a shaved beard under a shadow, cloth and hair of skin's own
colour. `prep.skin.mask` is for those.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.metrics import lab_from_linear_rec709
from scanrender.scan.bakedlight import fit_light
from scanrender.scan.diffuse import cotangent_laplacian, diffuse
from scanrender.scan.high import Low
from scanrender.scan.rasterize import Texels
from scanrender.scan.texelgraph import Mask, TexelGraph
from scanrender.scan.topology import unit, vertex_areas

Array = npt.NDArray[Any]

SMOOTH_MM = 0.8  # pores, stubble and single hairs are not a different material
LEAST = 2e-3  # albedo below which a camera's black says nothing about colour
# Mode of the colours: spans of (ln R, ln R/G, ln G/B) that count as near; light changes the first.
SPAN = np.array([0.5, 0.25, 0.3])
RADIUS = 1.5
FRONT = 0.2  # least z of the normals that are looked at
# White balance moves skin's ln R/G and ln G/B; below this redness a surface is stone or plaster.
LEAST_REDNESS, MOST_REDNESS = 0.16, 1.8
YELLOWNESS = (-0.35, 1.6)
LEAST_SHARE = 0.1  # of the front; and a third of the heaviest mode's
LIGHT_ROUNDS = 5
# Surroundings.
AROUND_MM = 12.0
FAR_WEIGHT = 0.02  # of the whole skin's colour, which alone counts where no skin is near
ROUNDS = 2
TEXELS_AT_VERTEX = 6
# Hair, in natural logarithms of red reflectance.
HAIR_RATIO = 0.15  # to skin's; measured where there is enough of it
HAIR_RATIOS = (0.05, 0.35)
DARK = -0.6  # what certainly is darker than skin, to measure hair by
HAIR_MM2 = 20.0
REDDER_FREE, REDDER_GAIN, REDDER_MOST = 0.05, 1.5, 0.5  # lips hold so much blood that red falls too
# Few lamps stand below a person: what looks down is darker than occlusion alone makes it.
UNDER, UNDER_SHARE = 0.3, 0.3
SHADE_MOST = 0.7  # a cavity of visibility 1/2 and less may be this much darker
SPREAD_FREE, SPREAD_GAIN, SPREAD_MOST = 0.05, 1.5, 0.25  # uneven light: darkness says less
# Eyes and cloth.
PALE = 0.5  # of the redness around
EYE_MM2 = 800.0  # paler islands up to this are eyes, if they touch something dark; larger, cloth
EYE_NEAR_MM, EYE_DARK_MM2, EYE_TOUCH, EYE_TOUCH_MM2 = 1.5, 4.0, 0.05, 2.0
CLOTH_MM2 = 300.0
CLOTH_HUE, CLOTH_REDDER, CLOTH_BRIGHTER = 0.5, 1.1, 0.9
LIP_REDDER = 0.2
# Clean-up: a strip of 2.5 mm or a disc of 3.7 mm just reaches this after this blur.
THICK_MM, THICK = 1.2, 0.7
SKIN_ISLAND_MM2 = 80.0  # glints on hair, the pink corner of an eye
SOFT_MM = 0.7


def skin_probability(
    low: Low, texels: Texels, albedo: Array, ao: Array | None = None
) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
    """(k,) in [0, 1] at the texels (k,) of `low`, from linear albedo (k, 3) there, and notes.

    ao (n,) is the ambient visibility at the welded vertices; without it creases may count as hair.
    notes: `skin_lab` (CIE Lab of the skin), `share_of_front`, `hair_ratio`, `spread` (of skin's
    ln R after the light is gone); only `no_skin_colour` where nothing has skin's colour, as on a
    statue: all of it counts as skin then.
    """
    positions = texels.interpolate(low.positions[low.faces])
    normals = unit(texels.interpolate(low.normals[low.faces]), fallback=(0.0, 0.0, 1.0))
    graph = TexelGraph(texels, positions, normals, low.texel_mm(texels.size))
    smooth = graph.smooth(albedo, SMOOTH_MM)
    signs = _signs(smooth)
    colour, share = _skin_colour(signs[normals[:, 2] > FRONT])
    if colour is None:
        return np.ones(len(albedo), np.float32), {"no_skin_colour": True}
    skin, light = _under_one_light(signs, normals, colour)
    if skin.sum() < 16:
        return np.ones(len(albedo), np.float32), {"no_skin_colour": True}
    signs[:, 0] -= light
    under = UNDER * np.maximum(-normals[:, 1], 0.0)
    shade = np.zeros(len(albedo))
    if ao is not None:
        visible = np.einsum("kc,kc->k", texels.bary, ao[low.faces[texels.face]])
        shade = np.minimum(-np.log(np.clip(visible, 0.1, 1.0)), SHADE_MOST)
    darkness, away, redness, notes = _compared(low, texels, signs, skin, shade)
    least = np.log(1.0 - 0.5 * (1.0 - notes["hair_ratio"]))  # half covered by hair
    dark = graph.keep(darkness < least, darkness + under < least, UNDER_SHARE)
    other = _other(graph, dark, away, redness)
    soft = graph.smooth(~other, SOFT_MM)
    lab = lab_from_linear_rec709(np.median(smooth[skin], axis=0))
    notes.update(skin_lab=[float(x) for x in lab], share_of_front=share)
    return np.clip(soft, 0.0, 1.0), notes


def _signs(albedo: Array) -> Array:
    """(k, 3) float64: ln R, redness ln R/G, yellowness ln G/B. Exposure changes only the first."""
    logarithm = np.log(np.maximum(albedo.astype(np.float64), LEAST))
    return np.column_stack([logarithm[:, 0], -np.diff(logarithm, axis=1)])


def _skin_colour(signs: Array) -> tuple[Array | None, float]:
    """The heaviest mode (3,) that can be skin, None without one, and its share of signs (k, 3).

    Of two modes alike the brighter is skin rather than hair.
    """
    if len(signs) == 0:
        return None, 0.0
    chosen = np.random.default_rng(0).permutation(len(signs))[:30_000]
    scaled = signs[chosen] / SPAN
    _, cell, count = np.unique(
        np.floor(scaled).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    modes = []
    for start in np.argsort(-count, kind="stable")[:15]:
        center = np.median(scaled[cell.reshape(-1) == start], axis=0)
        for _ in range(5):
            near = ((scaled - center) ** 2).sum(axis=1) < RADIUS**2
            center = np.median(scaled[near], axis=0) if near.any() else center
        modes.append((float(near.mean()), center * SPAN))
    least = max(LEAST_SHARE, max(share for share, _ in modes) / 3.0)
    able = [
        (share, mode)
        for share, mode in modes
        if share >= least
        and LEAST_REDNESS < mode[1] < MOST_REDNESS
        and YELLOWNESS[0] < mode[2] < YELLOWNESS[1]
    ]
    if not able:
        return None, 0.0
    share, mode = max(able, key=lambda pair: pair[0] * float(np.exp(0.5 * pair[1][0])))
    return mode, share


def _under_one_light(signs: Array, normals: Array, colour: Array) -> tuple[Mask, Array]:
    """What is skin (k,) by colour once the capture's light (k,), in ln R, is taken out."""
    skin = (((signs - colour) / SPAN) ** 2).sum(axis=1) < RADIUS**2
    light = np.zeros(len(signs))
    for _ in range(LIGHT_ROUNDS):
        if not skin.any():
            break
        weight = fit_light(signs[skin, 0], normals[skin])
        light = normals @ weight[1:]
        rest = signs[:, 0] - light
        rest -= np.median(rest[skin])
        near = np.abs(rest) < max(2.5 * _spread(rest[skin]), 0.25)
        skin = near & (np.abs(signs[:, 1:] - colour[1:]) < (0.35, 0.4)).all(axis=1)
    return skin, light


def _compared(
    low: Low, texels: Texels, signs: Array, skin: Mask, shade: Array
) -> tuple[Array, Array, Array, dict[str, Any]]:
    """Darkness (k,) that only hair explains, as ln R over that of the skin around; all signs (k, 3)
    less those around; redness (k,) around."""
    around = _Around(low, texels)
    whole = np.median(signs[skin], axis=0)
    ratio, extra = HAIR_RATIO, 0.0
    for _ in range(ROUNDS):
        local = around.mean(signs, skin, whole)
        away = signs - local
        redder = np.maximum(away[:, 1] - REDDER_FREE, 0.0)
        darkness = away[:, 0] + shade + np.minimum(REDDER_GAIN * redder, REDDER_MOST) + extra
        dark = darkness[darkness < DARK]
        if len(dark) * low.texel_mm(texels.size) ** 2 > HAIR_MM2:
            darker = np.median(dark[dark <= np.median(dark)])
            ratio = float(np.clip(np.exp(darker), *HAIR_RATIOS))
        hair = (1.0 - np.exp(darkness)) / (1.0 - ratio)
        skin = (hair < 0.4) & (np.abs(away[:, 2]) < 0.4) & (away[:, 0] < 0.8)
        skin &= away[:, 1] > -0.5 * local[:, 1]
        spread = _spread(away[skin, 0])
        extra = SPREAD_GAIN * max(0.0, min(spread, SPREAD_MOST) - SPREAD_FREE)
    return darkness, away, local[:, 1], {"hair_ratio": ratio, "spread": spread}


def _other(graph: TexelGraph, dark: Mask, away: Array, redness: Array) -> Mask:
    """(k,) what is no skin: the dark (hair, lashes, irises), eyes, cloth, without speckles."""
    pale = (away[:, 1] + redness < PALE * np.maximum(redness, LEAST_REDNESS)) & ~dark
    area = graph.areas_mm2(pale)
    core = graph.areas_mm2(dark) >= EYE_DARK_MM2
    nodes, piece, count = graph.islands(pale)
    beside = graph.grown(core, EYE_NEAR_MM)[nodes]
    touching = np.bincount(piece, beside, minlength=count)[piece] * graph.texel_mm**2
    eye = np.zeros(graph.count, bool)
    eye[nodes] = touching > np.maximum(EYE_TOUCH * area[nodes], EYE_TOUCH_MM2)
    pale &= eye | (area >= EYE_MM2)
    hue, redder = np.abs(away[:, 2]) > CLOTH_HUE, away[:, 1] > CLOTH_REDDER
    cloth = (hue & (away[:, 1] < LIP_REDDER)) | redder | (away[:, 0] > CLOTH_BRIGHTER)
    cloth &= ~dark
    cloth &= graph.areas_mm2(cloth) >= CLOTH_MM2
    other = graph.smooth(dark | pale | cloth, 0.5) > 0.5
    other = graph.keep(other, graph.smooth(other, THICK_MM) > THICK)
    skin = ~other
    enclosed = graph.keep(skin, skin & graph.grown(other, 0.0))  # not what is joined to nothing
    return np.asarray(other | (enclosed & (graph.areas_mm2(skin) < SKIN_ISLAND_MM2)))


def _spread(values: Array) -> float:
    """Standard deviation by the median of absolute deviations."""
    if len(values) == 0:
        return 0.0
    return float(1.4826 * np.median(np.abs(values - np.median(values))))


class _Around:
    """Means over the surface around each texel, by heat flow on the welded mesh."""

    def __init__(self, low: Low, texels: Texels) -> None:
        self.low, self.texels = low, texels
        # A few texels at each vertex say as much of a mean over so wide a region as all of them.
        self.every = max(1, len(texels.index) // (TEXELS_AT_VERTEX * len(low.positions)))
        self.corners = low.faces[texels.face[:: self.every]].reshape(-1)
        self.area = vertex_areas(low.positions, low.faces)
        self.laplacian = cotangent_laplacian(low.positions, low.faces)
        self.texel_count = np.maximum(self._gathered(np.ones(len(texels.index))), 1e-9)

    def mean(self, values: Array, chosen: Mask, whole: Array) -> Array:
        """(k, c) of values (k, c) over the chosen texels (k,) near each; `whole` (c,) where none
        is near."""
        columns = [*(values * chosen[:, None]).T, chosen.astype(np.float64)]
        held = np.stack([self._gathered(x) for x in columns], axis=1) / self.texel_count[:, None]
        held *= self.area[:, None]
        low = self.low
        flown = diffuse(low.positions, low.faces, held, AROUND_MM, self.laplacian, steps=1)
        total = (flown[:, :-1] + FAR_WEIGHT * whole) / (np.maximum(flown[:, -1:], 0) + FAR_WEIGHT)
        return self.texels.interpolate(total[low.faces])

    def _gathered(self, values: Array) -> Array:
        """(n,) sums at the vertices of values (k,) at texels."""
        cut = slice(None, None, self.every)
        weight = (self.texels.bary[cut] * values[cut, None]).reshape(-1)
        return np.bincount(self.corners, weight, minlength=len(self.area))
