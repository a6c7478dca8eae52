"""Draw how time and memory grow with the vertices and the frames: an SVG, of the figures in benchmarks/large.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

TITLE = "Processor time and peak memory by the number of vertices and of frames"
WIDTH, HEIGHT = 796, 316
LEFTS, TOP, SIDES = (62, 446), 52, (304, 204)
"""Pixels: left edges of the two charts, their upper edge, their width and height."""
CASES = (("mime", "vertices of the identity"), ("animate", "frames of the clip"))
TIME, MEMORY = "#3f6a94", "#a4622c"
"""Colours that read on light and on dark paper."""
SMALL = 'font-family="system-ui, sans-serif" font-size="12.5" fill="#7a736b"'

Point = tuple[float, float]


def growth_chart(report: dict[str, Any]) -> str:
    """Return an SVG with two charts: the whole time and the peak memory of the sizes that were measured."""
    drawn = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{TITLE}">',
        f"<title>{TITLE}</title>",
        f'<rect class="paper" width="{WIDTH}" height="{HEIGHT}" rx="10" fill="#fbfaf8"/>',
    ]
    for left, (case, label) in zip(LEFTS, CASES, strict=True):
        rows = report["cases"][case]
        drawn += chart(left, label, {int(size): rows[size] for size in sorted(rows, key=int)})
    return "\n".join([*drawn, "</svg>"]) + "\n"


def chart(left: float, label: str, rows: dict[int, dict[str, Any]]) -> list[str]:
    """Draw one chart: both axes logarithmic, a dashed line of slope 1 through the first time."""
    sizes = list(rows)
    seconds = [row["seconds"]["all"] for row in rows.values()]
    memory = [row["peak_mib"] / 1024 for row in rows.values()]
    across = Axis(decades(sizes), left, left + SIDES[0])
    up = Axis(decades([*seconds, *memory]), TOP + SIDES[1], TOP)
    bottom, right = TOP + SIDES[1], left + SIDES[0]
    drawn = [f'<rect class="box" x="{left}" y="{TOP}" width="{SIDES[0]}" height="{SIDES[1]}" fill="#f3f1ef" '
             'stroke="#6b645c" stroke-width="1.2"/>']  # fmt: skip
    drawn += [words(across.at(tick), bottom + 18, f"{tick:,.0f}") for tick in across.ticks]
    drawn += [words(left - 8, up.at(tick) + 4, f"{tick:g}", "end") for tick in up.ticks]
    drawn.append(words((left + right) / 2, bottom + 40, label))
    drawn.append(
        words(left, TOP - 26, f"seconds of processor time ({seconds[0]:.3g} to {seconds[-1]:.3g})", "start", TIME)
    )
    drawn.append(words(left, TOP - 9, f"GiB of memory ({memory[0]:.2g} to {memory[-1]:.2g})", "start", MEMORY))
    ends = [(size, seconds[0] * size / sizes[0]) for size in across.ends]
    drawn.append(
        line([(across.at(x), up.at(y)) for x, y in clipped(ends, up.ends)], "#7a736b", ' stroke-dasharray="4 4"')
    )
    for values, colour in ((seconds, TIME), (memory, MEMORY)):
        points = [(across.at(size), up.at(value)) for size, value in zip(sizes, values, strict=True)]
        drawn.append(line(points, colour))
        drawn += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in points]
    return drawn


class Axis:
    """A logarithmic axis of whole decades between two pixels."""

    def __init__(self, ticks: Sequence[float], start: float, stop: float) -> None:
        self.ticks, self.ends, self.start, self.stop = ticks, (ticks[0], ticks[-1]), start, stop

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        low, high = map(math.log10, self.ends)
        return self.start + (math.log10(value) - low) / (high - low) * (self.stop - self.start)


def decades(values: Sequence[float]) -> list[float]:
    """Return the powers of ten around some values, two at least."""
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    return [10.0**power for power in range(low, max(high, low + 1) + 1)]


def clipped(ends: Sequence[Point], limits: tuple[float, float]) -> list[Point]:
    """Cut a line of slope 1 to values between limits."""
    rate = ends[0][1] / ends[0][0]
    values = [min(max(value, limits[0]), limits[1]) for _, value in ends]
    return [(value / rate, value) for value in values]


def words(x: float, y: float, text: str, anchor: str = "middle", colour: str = "") -> str:
    """Draw a small text; `colour` instead of that of the page."""
    style = f' style="fill: {colour}"' if colour else ""
    return f'<text class="small" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {SMALL}{style}>{text}</text>'


def line(points: Sequence[Point], colour: str, more: str = "") -> str:
    """Draw a line through points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.8"{more}/>'
