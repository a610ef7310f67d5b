"""Walls of DXF drawings, read by ezdxf (extra ``dxf``): lines, polylines, arcs, curves, also in blocks."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import InputError
from gridslam.importers.plan_lines import LARGEST_BYTES, MOST_PIECES, NAMED_M, Line, unit_m

UNITS_M = {
    1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 10: 0.9144, 14: 0.1, 15: 10.0,
    16: 100.0, 21: 1200 / 3937,
}  # fmt: skip
"""Codes of ``$INSUNITS``."""
DRAWN = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")
SAGITTA_M, FEWEST_FACETS, MOST_FACETS = 0.01, 8, 200
DEEPEST, MOST_BLOCKS = 8, 20_000
FARTHEST_M, SHORTEST_M = 1e8, 1e-5


def read_walls(
    path: str | os.PathLike[str], unit: str | None = None, layers: Collection[str] = ()
) -> tuple[list[Line], str]:
    """Read the walls of the model space; a wall's material is its layer.

    Parameters
    ----------
    path : path
    unit : str, optional
        "m", "dm", "cm", "mm", "in" or "ft", instead of what the drawing says.
    layers : collection of str
        Only these; none stands for all that are switched on.

    Returns
    -------
    lines : list of Line, m
    note : str
        Unit that was used and what wasn't read.

    Raises
    ------
    InputError
        ezdxf isn't installed, the drawing is damaged or too large, or its unit is unknown.
    """
    path = Path(path)
    drawing = _open(path)
    scale, note = _scale(drawing, unit, str(path))
    known = {layer.dxf.name: layer for layer in drawing.layers}
    for name in layers:
        if name.lower() not in {other.lower() for other in known}:
            raise InputError("--layer", repr(name), ", ".join(sorted(known)))
    wanted = {name.lower() for name in layers}
    hidden = {name.lower() for name, layer in known.items() if layer.is_off() or layer.is_frozen()}
    lines: list[Line] = []
    skipped: dict[str, int] = {}
    budget = [MOST_BLOCKS]
    try:
        for entity, layer in _entities(drawing.modelspace(), "0", 0, budget, str(path)):
            here = layer.lower()
            if here not in wanted if wanted else here in hidden:
                continue
            kind = entity.dxftype()
            if kind not in DRAWN:
                skipped[kind] = skipped.get(kind, 0) + 1
                continue
            lines += [_named(line, layer) for line in _lines(entity, scale)]
            if len(lines) > MOST_PIECES:
                raise InputError(str(path), "too many lines", f"at most {MOST_PIECES}; choose with --layer")
    except InputError:
        raise
    except Exception as error:  # whatever ezdxf stumbles over in a damaged entity
        raise _damaged(path, error) from error
    if not lines:
        allowed = f"lines or arcs in the model space (layers {', '.join(sorted(known))[:200]})"
        raise InputError(str(path), "no walls", allowed)
    if skipped:
        note += "; not read: " + ", ".join(f"{count} {kind}" for kind, count in sorted(skipped.items()))
    return lines, note


def _open(path: Path) -> Any:
    try:
        import ezdxf
    except ImportError as error:
        raise InputError(str(path), "no ezdxf to read it", "pip install 'gridslam[dxf]'") from error
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(str(path), f"{path.stat().st_size} bytes", f"at most {LARGEST_BYTES}")
        return ezdxf.readfile(path)
    except InputError:
        raise
    except Exception as error:  # the parser raises whatever the damage leads it to
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
    found = f"no DXF that can be read ({' '.join(reason.split())[:100]})"
    return InputError(str(path), found, "a DXF drawing")


def _scale(drawing: Any, unit: str | None, where: str) -> tuple[float, str]:
    if unit is not None:
        return unit_m(unit), f"units: {unit}, as asked for"
    code = drawing.header.get("$INSUNITS", 0)
    if code == 0:
        return 1.0, "units: the drawing says none, read as metres (--unit mm if not)"
    if code not in UNITS_M:
        raise InputError(f"{where}: $INSUNITS", str(code), f"--unit with one of {', '.join(NAMED_M)}")
    return UNITS_M[code], f"units: {UNITS_M[code]:g} m, as the drawing says"


def _entities(place: Any, above: str, depth: int, budget: list[int], where: str) -> Iterator[tuple[Any, str]]:
    """All entities with their layers, those of blocks included; layer 0 of a block is that of its insert."""
    for entity in place:
        layer = str(entity.dxf.get("layer", "0"))
        layer = above if depth and layer == "0" else layer
        if entity.dxftype() != "INSERT":
            yield entity, layer
            continue
        copies = max(int(entity.mcount), 1)
        budget[0] -= copies
        if budget[0] < 0 or depth >= DEEPEST:
            raise InputError(where, "blocks in blocks without end", f"at most {MOST_BLOCKS}, {DEEPEST} deep")
        for single in entity.multi_insert() if copies > 1 else (entity,):
            yield from _entities(single.virtual_entities(), layer, depth + 1, budget, where)


def _named(line: Line, layer: str) -> Line:
    return Line(line.points, layer[:60] or "0", line.closed, None, None, line.arc)


def _lines(entity: Any, scale: float) -> Iterator[Line]:
    """One entity in metres."""
    kind = entity.dxftype()
    if kind in ("ARC", "CIRCLE") and tuple(entity.dxf.extrusion) == (0, 0, 1):
        x, y = scale * entity.dxf.center[0], scale * entity.dxf.center[1]
        radius = scale * entity.dxf.radius
        begin, end = (entity.dxf.start_angle, entity.dxf.end_angle) if kind == "ARC" else (0.0, 360.0)
        sweep = (end - begin) % 360 or 360.0
        begin = begin % 360
        if SHORTEST_M < radius * math.radians(sweep) / MOST_FACETS and all(
            abs(v) < FARTHEST_M for v in (x, y, radius)
        ):
            arc = {"centre_m": [round(x, 6), round(y, 6)], "radius_m": round(radius, 6)}
            arc |= {"from_deg": round(begin, 6), "to_deg": round(begin + sweep, 6)}
            yield Line((), arc=arc | {"facets": _facets(radius, sweep)})
        return
    if kind == "LINE":
        points = [entity.dxf.start, entity.dxf.end]
        closed = False
    else:
        points, closed = _flattened(entity, scale)
    flat = tuple((scale * float(p[0]), scale * float(p[1])) for p in points)
    if flat and np.abs(flat).max() < FARTHEST_M:
        yield Line(flat, closed=closed)


def _flattened(entity: Any, scale: float) -> tuple[list[Any], bool]:
    """Corners of a polyline or curve; a curve has so many that they stay within a centimetre of it."""
    from ezdxf import path as paths

    if entity.dxftype() == "POLYLINE" and not (entity.is_2d_polyline or entity.is_3d_polyline):
        return [], False
    whole = paths.make_path(entity)
    controls = np.array([(p.x, p.y) for p in whole.control_vertices()]).reshape(-1, 2)
    if not len(controls) or not np.isfinite(controls).all() or np.abs(controls).max() * scale > FARTHEST_M:
        return [], False
    size = float(np.ptp(controls, axis=0).max())
    step = max(SAGITTA_M / scale, size / 1000)
    points = list(whole.flattening(step, segments=4)) if whole.has_curves else list(whole.control_vertices())
    return points, bool(whole.is_closed)


def _facets(radius: float, sweep_deg: float) -> int:
    """So many that their middles stay within a centimetre of the arc."""
    half = math.acos(max(1 - SAGITTA_M / radius, 0.0)) if radius > SAGITTA_M else math.pi / 4
    return int(np.clip(math.ceil(math.radians(sweep_deg) / (2 * half)), FEWEST_FACETS, MOST_FACETS))
