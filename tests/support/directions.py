"""`animate` and `transfer` without corrections of arms, for results whose limbs have the directions of the driving's."""

from __future__ import annotations

from functools import partial

import mimesh
from mimesh.core.options import MotionOptions

DIRECTIONS = MotionOptions(contacts=False)
animate = partial(mimesh.animate, motion=DIRECTIONS)
transfer = partial(mimesh.transfer, motion=DIRECTIONS)
