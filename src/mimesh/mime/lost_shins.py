"""Find a shin that was predicted on the other leg.

Of people who sit with an ankle on the other knee, a network often puts both shins on the leg that stands. The fitted
body then leaves the shin that lies across uncovered, and has a part of a leg where there is no surface. The foot of
that leg is put where the uncovered surface is farthest from its knee, and the body is fitted again. It keeps that pose
if it covers more of the surface, and both legs lie nearer to it (docs/log/mime.md, "A shin on the other knee").
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES
from ..rigs.confidence import MAX_UNMATCHED_SURFACE
from .body_fit import BODY_POINTS, BodyFit, SurfaceSample, fit_body, is_uncovered, limb_gaps
from .joint_targets import JointTargets

LOST_LEG = 0.05
"""Share of a leg of the fitted body away from the surface from which on its shin is looked for."""
LESS_UNCOVERED, NEARER = 0.7, 0.9
"""Ratios of the uncovered surface, and of the gaps of both legs, after a fit to before, up to which it is kept."""
REACH, SOLE = 1.5, 0.15
"""How far from its knee a leg's surface ends at most: lengths of its shin, and metres of the body more. Lengths of
bones of other people differ, and a foot adds to them."""
TIP = 0.1
"""Share of the uncovered surface that is the tip of the leg."""


def lost_shin(surface: SurfaceSample, fit: BodyFit) -> JointTargets | None:
    """Return knees and feet of a person with a shin elsewhere than where the fitted body has it; None: there is none.

    Args:
        surface: normalised, as the positions that are returned.
        fit: of a person to it.
    """
    names, size = fit.posed.body.names, fit.posed.state.size
    legs = {side: [names.index(f"{side}{bone}") for bone in ("Leg", "Foot")] for side in SIDES}
    lost = [side for side in SIDES if fit.unmatched_body[f"{side.lower()} leg"] > LOST_LEG]
    if not lost or fit.unmatched_surface <= MAX_UNMATCHED_SURFACE:
        return None
    points = surface.points[: 2 * BODY_POINTS]
    uncovered = points[is_uncovered(fit.posed, points)]
    fits = []
    for side in lost:
        foot = _foot(uncovered, fit.joints[legs[side]], size)
        if foot is not None:
            moved = JointTargets(legs[side][1:], foot[None]).move(fit.rotation, fit.joints)
            fits.append(fit_body(surface, *moved))
    gap, before = (lambda of: _gap(of, surface)), _gap(fit, surface)
    best = min(fits, key=gap, default=fit)
    if best.unmatched_surface > LESS_UNCOVERED * fit.unmatched_surface or gap(best) > NEARER * before:
        return None
    found = [joint for side in SIDES for joint in legs[side]]
    return JointTargets(found, best.joints[found])


def _foot(
    uncovered: Float[np.ndarray, "N 3"], shin: Float[np.ndarray, "2 3"], size: float
) -> Float[np.ndarray, " 3"] | None:
    """Place the foot of a shin, from knee to foot, towards the farthest points that it reaches; None: it reaches none.

    Args:
        size: of the body, in the unit of the points.
    """
    knee, length = shin[0], np.linalg.norm(shin[1] - shin[0])
    away = np.linalg.norm(uncovered - knee, axis=1)
    reached = uncovered[np.argsort(away)][: int((away < REACH * length + SOLE * size).sum())]
    if len(reached) == 0:
        return None
    along = reached[-max(1, int(TIP * len(reached))) :].mean(axis=0) - knee
    return knee + along * length / np.linalg.norm(along)


def _gap(fit: BodyFit, surface: SurfaceSample) -> float:
    """Measure how far both legs of a fitted body and the surface next to them are apart (metres of the body)."""
    gaps = limb_gaps(fit.posed, surface)
    return sum(gaps[f"{side.lower()} leg"] for side in SIDES)
