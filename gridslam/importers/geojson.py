"""GeoJSON: walls in, detected surfaces out. Coordinates are metres of the scene unless told otherwise."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.estimate_tables import FREE, MIRROR, SCATTERER, FeatureEstimate, SurfaceEstimate
from gridslam.importers.plan_lines import LARGEST_BYTES, MOST_PIECES, Line, unit_m
from gridslam.io.files import write_bytes
from gridslam.io.foreign import refuse_foreign_text
from gridslam.maps.walls import WallSegments

OURS = '{\n "type": "FeatureCollection",\n "features": ['
"""How a file that is written here begins: indented by one, as no other program's known to us."""
DEEPEST = 20
EARTH_M = 6_378_137.0
FLATTENING = 1 / 298.257223563
SMALLEST_M = 0.05
"""A plan smaller than this isn't in metres: floor plans in degrees are."""


def read_walls(path: str | os.PathLike[str], geographic: bool = False, unit: str | None = None) -> list[Line]:
    """Read all lines and polygons, with their ``material``, ``reflection`` and ``name``.

    Parameters
    ----------
    path : path
    geographic : bool
        Coordinates are longitudes and latitudes (WGS 84), to be flattened about their middle.
    unit : str, optional
        Of coordinates, as `floorplans.NAMED_M` names it; metres unless told.

    Raises
    ------
    InputError
        Not GeoJSON, coordinates that are no numbers, properties that make no sense, an unknown unit, or one
        of degrees.
    """
    path = Path(path)
    if geographic and unit is not None:
        raise InputError("--unit", f"{unit!r} with --geographic, which is degrees", "one of the two")
    scale = 1.0 if unit is None else unit_m(unit)
    lines = []
    for geometry, properties, where in _features(_load(path), f"{path}", 0):
        material, reflection, name = _properties(properties, where)
        for ring, closed in _rings(geometry, where, 0):
            lines.append(Line(ring, material, closed, reflection, name))
            if len(lines) > MOST_PIECES:
                raise InputError(str(path), "too many lines", f"at most {MOST_PIECES}")
    if not lines:
        raise InputError(str(path), "no walls", "LineString or Polygon features")
    return _in_metres(lines, geographic, scale, str(path))


def _load(path: Path) -> Any:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(str(path), f"{path.stat().st_size} bytes", f"at most {LARGEST_BYTES}")
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(str(path), error.strerror or "no file", "a GeoJSON file") from error
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # broken JSON, bytes that aren't text, endless numbers
        found = f"broken JSON ({' '.join(str(error).split())[:100]})"
        raise InputError(str(path), found, "a GeoJSON file") from error


def _features(item: Any, where: str, depth: int) -> Iterator[tuple[dict[str, Any], dict[str, Any], str]]:
    """Geometries with the properties of their feature."""
    if not isinstance(item, dict) or depth > DEEPEST:
        raise InputError(where, "no GeoJSON object", "a FeatureCollection, Feature or geometry")
    kind = item.get("type")
    if kind == "FeatureCollection":
        for number, feature in enumerate(_list(item.get("features"), f"{where}: features")):
            yield from _features(feature, f"{where}: features[{number}]", depth + 1)
    elif kind == "Feature":
        if item.get("geometry") is not None:
            properties = item.get("properties") or {}
            if not isinstance(properties, dict):
                raise InputError(f"{where}: properties", "something else", "an object")
            if not isinstance(item["geometry"], dict):
                raise InputError(f"{where}: geometry", "something else", "an object")
            yield item["geometry"], properties, where
    else:
        yield item, {}, where


def _rings(geometry: Any, where: str, depth: int) -> Iterator[tuple[tuple[tuple[float, float], ...], bool]]:
    if not isinstance(geometry, dict) or depth > DEEPEST:
        raise InputError(where, "no geometry", "a GeoJSON geometry")
    kind, found = geometry.get("type"), geometry.get("coordinates")
    place = f"{where}: coordinates"
    if kind == "GeometryCollection":
        for item in _list(geometry.get("geometries"), f"{where}: geometries"):
            yield from _rings(item, where, depth + 1)
    elif kind == "LineString":
        yield _points(found, place), False
    elif kind in ("MultiLineString", "Polygon"):
        for ring in _list(found, place):
            yield _points(ring, place), kind == "Polygon"
    elif kind == "MultiPolygon":
        for polygon in _list(found, place):
            for ring in _list(polygon, place):
                yield _points(ring, place), True
    elif kind not in ("Point", "MultiPoint"):  # points are no walls
        allowed = "LineString, Polygon, their Multi forms or GeometryCollection"
        raise InputError(f"{where}: type", repr(kind)[:40], allowed)


def _list(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(where, "no list", "a list")
    return value


def _points(values: Any, where: str) -> tuple[tuple[float, float], ...]:
    points = []
    for pair in _list(values, where):
        good = isinstance(pair, list) and len(pair) >= 2 and all(_real(x) for x in pair[:2])
        if not good:
            raise InputError(where, repr(pair)[:40], "[x, y] in numbers")
        points.append((float(pair[0]), float(pair[1])))
    return tuple(points)


def _real(value: Any) -> bool:
    try:
        return (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and math.isfinite(value)
            and abs(value) < 1e9
        )
    except OverflowError:  # a whole number with hundreds of digits
        return False


def _properties(table: dict[str, Any], where: str) -> tuple[str, float | None, str | None]:
    reflection, material, name = table.get("reflection"), table.get("material"), table.get("name")
    if reflection is not None and not (_real(reflection) and 0 < reflection <= 1):
        found = repr(reflection)[:40]
        raise InputError(f"{where}: properties.reflection", found, "a number above 0, up to 1")
    if material is None:
        material = "concrete" if reflection is None else f"reflection {float(reflection):g}"
    if not isinstance(material, str) or not 0 < len(material) <= 60:
        raise InputError(f"{where}: properties.material", repr(material)[:40], "a name")
    named = name if isinstance(name, str) and name else None
    return material, None if reflection is None else float(reflection), named


def _in_metres(lines: list[Line], geographic: bool, unit_in_m: float, where: str) -> list[Line]:
    points = np.array([point for line in lines for point in line.points]).reshape(-1, 2)
    if not len(points):
        raise InputError(where, "no walls", "lines with points")
    if geographic:
        return _replaced(lines, _flattened(points, where))
    size = unit_in_m * np.ptp(points, axis=0).max()
    if size < SMALLEST_M:
        allowed = "metres, another --unit, or --geographic for degrees"
        raise InputError(where, f"a plan {size:.3g} m wide", allowed)
    return _replaced(lines, unit_in_m * points) if unit_in_m != 1 else lines


def _flattened(points: Array, where: str) -> Array:
    """Longitudes and latitudes as metres about their middle."""
    if np.abs(points[:, 0]).max() > 180 or np.abs(points[:, 1]).max() > 89:
        raise InputError(where, "numbers beyond 180 or 89", "longitudes and latitudes with --geographic")
    middle = 0.5 * (points.min(0) + points.max(0))
    latitude, squared = np.radians(middle[1]), FLATTENING * (2 - FLATTENING)
    bend = 1 - squared * np.sin(latitude) ** 2
    scale = np.radians(EARTH_M) * np.array([np.cos(latitude) / bend**0.5, (1 - squared) / bend**1.5])
    return np.asarray((points - middle) * scale)


def _replaced(lines: list[Line], points: Array) -> list[Line]:
    """The lines with these points, in the same order."""
    rest = iter(points.tolist())
    return [replace(line, points=tuple((x, y) for x, y in islice(rest, len(line.points)))) for line in lines]


def surfaces(found: SurfaceEstimate, walls: WallSegments | None = None) -> dict[str, Any]:
    """Detected surfaces as a FeatureCollection, metres in the scene's frame.

    Each is a LineString, or a MultiLineString where it has several stretches (null where it has none), with
    its number, existence, reflection coefficient and standard deviation (null where nothing was learned of
    it), surface feature vector and length.

    Parameters
    ----------
    found : SurfaceEstimate
    walls : WallSegments, optional
        Stretches of these surfaces where there is a wall, as `Map.wall_segments` gives them; without, the
        whole extent is one.
    """
    features = []
    deviation = np.sqrt(np.maximum(found.reflection_var, 0))
    coefficient, spread = np.where(found.reflection_learned, [found.reflection, deviation], np.nan)
    for number, ends in enumerate(found.ends_m):
        if walls is not None:
            own = walls.surface == number
            stretches, reach = walls.ends_m[own], walls.extent_m[own]
        else:
            seen = bool(np.isfinite(ends).all())
            stretches, reach = ends[None][:seen], found.extent_m[number][None][:seen]
        properties = {
            "id": int(found.identity[number]),
            "existence": _number(found.existence[number]),
            "reflection": _number(coefficient[number]),
            "reflection_std": _number(spread[number]),
            "sfv_m": [_number(x) for x in found.sfv_m[number]],
            "normal_rad": _number(found.line[number, 0]),
            "offset_m": _number(found.line[number, 1]),
            "offset_std_m": _number(np.sqrt(max(found.line_cov[number, 1, 1], 0))),
            "extent_m": [float(reach.min()), float(reach.max())] if len(reach) else None,
            "length_m": float(np.ptp(reach, axis=1).sum()) if len(reach) else None,
        }
        lines = stretches.tolist()
        geometry = {"type": "LineString", "coordinates": lines[0]} if len(lines) == 1 else None
        geometry = {"type": "MultiLineString", "coordinates": lines} if len(lines) > 1 else geometry
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    return {"type": "FeatureCollection", "features": features}


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def write_surfaces(
    path: str | os.PathLike[str], found: SurfaceEstimate, walls: WallSegments | None = None
) -> None:
    """Write detected surfaces as GeoJSON, see `surfaces`.

    Raises
    ------
    InputError
        The file can't be written.
    """
    _write(path, surfaces(found, walls))


def features(found: FeatureEstimate) -> dict[str, object]:
    """Learned features as a GeoJSON FeatureCollection of points, in metres of the scene's frame.

    Each has its anchor and where that stands, the extra length and its deviation, the power over the noise
    at 1 m, and what it is: mirror, scatterer or free.
    """
    names = {FREE: "free", MIRROR: "mirror", SCATTERER: "scatterer"}
    rows = []
    for n in range(len(found)):
        square = found.covariance[n]
        rows.append({
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": found.position_m[n].tolist()},
            "properties": {
                "identity": int(found.identity[n]), "anchor": int(found.anchor[n]),
                "anchor_m": found.anchor_m[n].tolist(), "kind": names.get(int(found.kind[n]), "free"),
                "bias_m": float(found.bias_m[n]), "bias_std_m": float(np.sqrt(square[2, 2])),
                "position_cov_m2": square[:2, :2].tolist(),
                "power_over_noise_db": float(10 * np.log10(max(found.variance[n] / found.noise[n], 1e-30))),
                "steps_seen": int(found.steps_seen[n]),
            },
        })  # fmt: skip
    return {"type": "FeatureCollection", "features": rows}


def write_features(path: str | os.PathLike[str], found: FeatureEstimate) -> None:
    """Write learned features as GeoJSON, see `features`.

    Raises
    ------
    InputError
        The file can't be written.
    """
    _write(path, features(found))


def _write(path: str | os.PathLike[str], content: dict[str, object]) -> None:
    refuse_foreign_text(path, "a GeoJSON file that was written here", lambda head: head.startswith(OURS))
    write_bytes(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())
