"""Floor plans of other programs as scene files that a person can go on editing.

A reader (`geojson`, `dxf`) makes lines of a file, `Plan` puts them together, and its text is a scene file
with every assumption said in a comment; `plan_files` writes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import tomli_w

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.importers.plan_lines import MOST_PIECES, Line
from gridslam.world.grid_memory import CELL_BYTES, MOST_BYTES, in_gb
from gridslam.world.scene import Scene
from gridslam.world.scene_parts import SAME_PLACE_M, Wall

KNOWN = {"concrete": 0.7, "glass": 0.3}
ASSUMED = 0.7
FARTHEST_M, SMALLEST_M = 10_000.0, 0.3
"""From the origin; and width or depth of a plan that can be one of a room."""
MARGIN_M, ROUND_M = 1.0, 0.5


@dataclass(frozen=True)
class Plan:
    """What a floor plan says, and what was added to it.

    Attributes
    ----------
    name : str
    lines : tuple of Line
    reflection : dict of float
        Coefficients by material, beyond those of the lines.
    anchors : tuple of (x, y, deg)
    start : (x, y, deg) or None
        Where the agent starts.
    cell_m : float, m
    source : str
        Name of the file, for the comment.
    heights_m : tuple of float
        Of the anchors; empty: all is planar.
    start_height_m : float or None
        Of the agent, where the anchors have heights.
    """

    name: str
    lines: tuple[Line, ...]
    reflection: Mapping[str, float]
    anchors: tuple[tuple[float, float, float], ...] = ()
    start: tuple[float, float, float] | None = None
    cell_m: float = 0.1
    source: str = "a floor plan"
    heights_m: tuple[float, ...] = ()
    start_height_m: float | None = None

    @property
    def materials(self) -> dict[str, tuple[float, str]]:
        """Coefficient of each material, and where it comes from."""
        table: dict[str, tuple[float, str]] = {}
        for line in self.lines:
            if line.material in self.reflection:
                table[line.material] = self.reflection[line.material], "as asked for"
            elif line.reflection is not None:
                table[line.material] = line.reflection, "from the plan"
            elif line.material.lower() in KNOWN:  # layers are often in capitals
                table.setdefault(line.material, (KNOWN[line.material.lower()], "assumed for this material"))
            else:
                table.setdefault(line.material, (ASSUMED, "assumed: the plan doesn't say"))
        return table

    @property
    def corners(self) -> Array:
        """All corners of all walls, arcs as facets, (P, 2) m."""
        return np.concatenate([Wall.checked(line.wall, self.source).corners for line in self.lines])

    @property
    def region(self) -> tuple[list[float], list[float]]:
        """Region to map, about everything with a margin: ([x, x], [y, y]) m."""
        places = [self.corners, np.reshape([a[:2] for a in self.anchors], (-1, 2))]
        places += [np.reshape(self.start[:2], (1, 2))] if self.start else []
        whole = np.concatenate(places)
        low = np.floor((whole.min(0) - MARGIN_M) / ROUND_M) * ROUND_M
        high = np.ceil((whole.max(0) + MARGIN_M) / ROUND_M) * ROUND_M
        return [float(low[0]), float(high[0])], [float(low[1]), float(high[1])]

    @property
    def outside(self) -> list[str]:
        """Anchors and start that stand farther outside the walls than the margin, one line each."""
        low, high = self.corners.min(0), self.corners.max(0)
        placed = [(f"anchor {letters(number)}", anchor) for number, anchor in enumerate(self.anchors)]
        placed += [("the start", self.start)] if self.start else []
        lines = []
        for name, (x, y, _) in placed:
            gap = float(np.hypot(*np.maximum(np.maximum(low - (x, y), (x, y) - high), 0.0)))
            if gap > MARGIN_M:
                walls = f"x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g} m"
                lines.append(f"{name} at {x:g}, {y:g} m stands {gap:.1f} m outside the walls ({walls})")
        return lines

    def toml(self) -> str:
        """The scene file, with comments.

        Raises
        ------
        InputError
            With anchors: any fault that the scene has.
        """
        x, y = self.region
        materials = self.materials
        source = printable(self.source)
        lines = [
            f"# Walls from {source}: {len(self.lines)} of them. Edit freely; `gridslam check`",
            "# says whether it is still a scene. Lengths in m, angles in degrees, counter-clockwise from x.",
            *_pairs(name=self.name),
            "",
            "[grid]                        # region to map",
            *_pairs(x_m=x, y_m=y, cell_m=self.cell_m),
            "",
            "[materials]                   # amplitude reflection coefficients",
        ]
        lines += [f"{_pairs(**{n: value})[0]}  # {why}" for n, (value, why) in materials.items()]
        for number, (px, py, facing) in enumerate(self.anchors):
            lines += ["", "[[anchors]]"]
            place = [px, py, *self.heights_m[number : number + 1]]
            lines += _pairs(name=letters(number), position_m=place, orientation_deg=facing)
        if not self.anchors:
            lines += [
                "",
                "# Every scene needs an anchor: put yours here and take the signs away.",
                "# [[anchors]]",
                '# name = "A"',
                f"# position_m = [{(x[0] + x[1]) / 2:g}, {(y[0] + y[1]) / 2:g}]",
                "# orientation_deg = 0.0",
            ]
        if self.start:
            lines += ["", "[[agents]]"]
            lines += _pairs(name="agent1", start_m=list(self.start[:2]), start_heading_deg=self.start[2])
            lines += _pairs(height_m=self.start_height_m) if self.start_height_m is not None else []
        else:
            lines += ["", "# [[agents]]", '# name = "agent1"', "# start_m = [0.0, 0.0]"]
            lines += ["# start_heading_deg = 0.0"]
        px, py, facing = self.start or (0.0, 0.0, 0.0)
        turn = math.radians(facing)
        ahead = [round(px + math.cos(turn), 3), round(py + math.sin(turn), 3)]
        lines += [f"# waypoints_m = [{ahead}]   # a way to simulate: where it goes from its start"]
        for line in self.lines:
            lines += ["", "[[walls]]", *_pairs(**line.wall)]
        text = "\n".join(lines) + "\n"
        if self.anchors:
            Scene.from_toml(text, self.source)
        return text


def plan_of(
    lines: Sequence[Line],
    source: str,
    rename: Mapping[str, str] | None = None,
    reflection: Mapping[str, float] | None = None,
    origin_m: tuple[float, float] = (0.0, 0.0),
    **more: Any,
) -> Plan:
    """Put lines together: materials renamed, moved, without points that repeat.

    Parameters
    ----------
    lines : sequence of Line
    source : str
        Name of the file that they come from.
    rename : mapping, optional
        Materials by what the file calls them (its layers).
    reflection : mapping, optional
        Coefficients by material.
    origin_m : (x, y), m
        Place in the plan that becomes the scene's origin.
    **more
        Other arguments of `Plan`.

    Raises
    ------
    InputError
        Nothing to read, too much, or far from the origin.
    """
    rename, reflection = dict(rename or {}), dict(reflection or {})
    for name in rename:
        if name not in {line.material for line in lines}:
            known = ", ".join(sorted({line.material for line in lines})) or "none"
            raise InputError("--material", repr(name), f"what {source} has: {known}")
    moved = [
        _moved(replace(line, material=rename.get(line.material, line.material)), origin_m) for line in lines
    ]
    drawn = tuple(line for line in moved if line is not None)
    if not drawn:
        raise InputError(source, "no walls", "lines or polygons")
    lines = _apart(drawn)
    plan = Plan(source=source, lines=lines, reflection=_of_materials(reflection, lines, source), **more)
    pieces = sum(len(line.points) or int((line.arc or {}).get("facets", 1)) for line in drawn)
    if pieces > MOST_PIECES:
        raise InputError(source, f"{pieces} pieces of walls", f"at most {MOST_PIECES}")
    places = [np.reshape(line.points or [line.arc["centre_m"]], (-1, 2)) for line in drawn]  # type: ignore[index]
    whole = np.concatenate(places)
    _check_size(plan, np.ptp(whole, axis=0))
    if np.abs(whole).max() > FARTHEST_M:
        near = f"--origin {whole[:, 0].min() + origin_m[0]:.0f},{whole[:, 1].min() + origin_m[1]:.0f}"
        raise InputError(source, f"walls {np.abs(whole).max():.0f} m from the origin", near)
    _check_places(plan)
    return plan


def _check_size(plan: Plan, size: Array) -> None:
    """Refuse walls within so large a `size` (2,) m that there are too many cells, or too small for a room."""
    if size.max() < SMALLEST_M:
        found = f"a plan of {1e3 * size[0]:.3g} mm x {1e3 * size[1]:.3g} mm"
        raise InputError(plan.source, found, f"{SMALLEST_M:g} m or more: --unit m if it is drawn in metres")
    need = size[0] * size[1] / plan.cell_m**2 * CELL_BYTES
    if need > MOST_BYTES:
        found = f"a plan of {size[0]:.0f} m x {size[1]:.0f} m, whose cells of {plan.cell_m:g} m need"
        allowed = f"{in_gb(MOST_BYTES)}: --unit mm or cm where it isn't in metres, or a larger --cell"
        raise InputError(plan.source, f"{found} {in_gb(need)}", allowed)


def _check_places(plan: Plan) -> None:
    """Refuse anchors and a start so far outside the walls that the region has too many cells."""
    width, height = np.ptp(plan.region, axis=1)
    need = width * height / plan.cell_m**2 * CELL_BYTES
    if need > MOST_BYTES and plan.outside:
        found = f"{plan.outside[0]}, so a region of {width:.0f} m x {height:.0f} m, whose cells need"
        allowed = f"{in_gb(MOST_BYTES)}: places in m (--origin moves the walls), or a larger --cell"
        raise InputError("--anchor, --start", f"{found} {in_gb(need)}", allowed)


def _of_materials(asked: Mapping[str, float], lines: Sequence[Line], source: str) -> dict[str, float]:
    """Coefficients that were asked for, by the names that walls have, whatever their case.

    Raises
    ------
    InputError
        No wall is of such a material.
    """
    known = sorted({line.material for line in lines})
    found: dict[str, float] = {}
    for name, value in asked.items():
        own = [one for one in known if one == name] or [one for one in known if one.lower() == name.lower()]
        if not own:
            raise InputError("--reflection", repr(name), f"what {source} has: {', '.join(known)}")
        found |= dict.fromkeys(own, value)
    return found


def _moved(line: Line, origin: tuple[float, float]) -> Line | None:
    """The line about another origin, without repeated points; None if nothing is left."""
    if line.arc is not None:
        x, y = line.arc["centre_m"]
        return replace(line, arc={**line.arc, "centre_m": [x - origin[0], y - origin[1]]})
    points = np.reshape(np.array(line.points, dtype=np.float64), (-1, 2)) - origin
    if not np.isfinite(points).all():
        return None
    apart: list[tuple[float, float]] = []
    for x, y in points.tolist():
        if not apart or np.hypot(x - apart[-1][0], y - apart[-1][1]) >= 10 * SAME_PLACE_M:
            apart.append((round(x, 6), round(y, 6)))
    closed = line.closed
    if (
        len(apart) > 2
        and np.hypot(apart[0][0] - apart[-1][0], apart[0][1] - apart[-1][1]) < 10 * SAME_PLACE_M
    ):
        apart, closed = apart[:-1], True
    return replace(line, points=tuple(apart), closed=closed and len(apart) > 2) if len(apart) > 1 else None


def _apart(lines: tuple[Line, ...]) -> tuple[Line, ...]:
    """Walls of one material with different coefficients become different materials."""
    found: dict[str, set[float | None]] = {}
    for line in lines:
        found.setdefault(line.material, set()).add(line.reflection)
    return tuple(
        line
        if len(found[line.material]) == 1 or line.reflection is None
        else replace(line, material=f"{line.material} {line.reflection:g}"[:100])
        for line in lines
    )


def _pairs(**values: Any) -> list[str]:
    """Lines ``key = value`` of TOML, tables within one line."""
    lines = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            lines.append(f"{key} = {{ {', '.join(_pairs(**value))} }}")
        elif isinstance(value, list):
            inner = ", ".join(_pairs(x=item)[0].removeprefix("x = ") for item in value)
            lines.append(f"{tomli_w.dumps({key: 0}).split(' = ')[0]} = [{inner}]")
        else:
            lines.append(tomli_w.dumps({key: value}).rstrip("\n"))
    return lines


def printable(text: str) -> str:
    """A name that comments and figures can show."""
    return "".join(c if c.isprintable() else "?" for c in text)[:80]


def letters(number: int) -> str:
    """Name of an anchor by its number: A, B, ... Z, then A1, B1, ..."""
    return chr(ord("A") + number % 26) + (str(number // 26) if number >= 26 else "")
