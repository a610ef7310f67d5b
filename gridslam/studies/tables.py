"""Tables of a study: one row per run, one per step, and one per method with what the runs amount to."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.io.files import write_bytes
from gridslam.studies.batches import Batch
from gridslam.studies.spread import NOTHING, Difference, difference, squares, standard_error
from gridslam.studies.study import Variant

SETTLED = 50
"""First step of the issue's, and the paper's, steady numbers; halfway if a track is short."""
PLACE = "position_error_m"


def run_rows(found: Iterable[Batch]) -> list[dict[str, Any]]:
    """One row per run and agent: what was run, its scores as in run.json, what it cost."""
    rows = []
    for batch in found:
        for record in batch.records:
            own = record["agents"][batch.agent]
            whole = {"network": _plain(record.get("network", {}))}
            who = _who(batch) | {"seed": record["key"]["seed"]}
            rows.append(who | dict(_flat(own["scores"] | whole)) | own["cost"])
    return rows


def step_rows(found: Iterable[Batch]) -> list[dict[str, Any]]:
    """One row per step and method: errors over the runs, the bounds, detected against true."""
    rows = []
    for batch in found:
        mark, (low, high) = batch.benchmark, batch.band
        position, heading = (
            batch.quantiles("position_error_m"),
            np.degrees(batch.quantiles("heading_error_rad")),
        )
        columns = {
            "position_rmse_m": batch.rmse("position_error_m"),
            "position_p10_m": position[0],
            "position_p90_m": position[1],
            "position_known_map_bound_m": mark.known.position_m,
            "position_unknown_map_bound_m": mark.unknown.position_m,
            "heading_rmse_deg": np.degrees(batch.rmse("heading_error_rad")),
            "heading_p10_deg": heading[0],
            "heading_p90_deg": heading[1],
            "heading_known_map_bound_deg": np.degrees(mark.known.heading_rad),
            "heading_unknown_map_bound_deg": np.degrees(mark.unknown.heading_rad),
            "position_nees": batch.mean("position_nees"),
            "position_nees_low": np.full(mark.rays.shape[1], low),
            "position_nees_high": np.full(mark.rays.shape[1], high),
            "heading_nees": batch.mean("heading_nees"),
            "mospa_m": batch.mapped(batch.mean("surface_ospa_m")),
            "mospa_at_bounds_m": mark.mospa_at_bounds_m,
            "image_mospa_m": batch.mapped(batch.mean("image_ospa_m")),
            "surfaces": batch.mean("surfaces"),
            "surfaces_true": mark.surfaces,
            "rays": batch.mean("rays").sum(0),
            "ray_belief": batch.mean("ray_belief").sum(0),
            "rays_true": mark.rays.sum(0),
            "rays_likely": mark.likely_rays.sum(0),
        }
        size = min(len(column) for column in columns.values())
        for step in range(size):
            own = {name: column[step].item() for name, column in columns.items()}
            rows.append(_who(batch) | {"step": step, "runs": batch.runs} | own)
    return rows


def summary_rows(found: Iterable[Batch]) -> list[dict[str, Any]]:
    """One row per method: the errors and their ratio to the bounds once settled (from step 50 on).

    ``..._standard_error_...``: over the seeds; ``position_less_first_m``: root mean square error minus
    that of the first method of the same scene, settings and agent, on the same seeds, NaN of that method;
    ``nees_in_band``: share of all steps whose mean position NEES lies in the 95 % band;
    ``surface_ospa_m``, ``surface_gospa_m``: mean at the end; ``image_ospa_m``: OSPA of the virtual anchors,
    mean once settled; all are NaN for methods that map no surfaces;
    ``ray_excess``: detected minus visible paths per anchor and step; ``likely_ray_excess``: minus those that
    are likelier detected than missed.
    """
    rows = []
    first = dict[tuple[Variant, str], Batch]()
    for batch in found:
        mark, (low, high) = batch.benchmark, batch.band
        size = batch.steps["position_error_m"].shape[1]
        late = slice(min(SETTLED, size // 2), size)
        position, heading = batch.rmse("position_error_m")[late], batch.rmse("heading_error_rad")[late]
        nees, rays = batch.mean("position_nees"), batch.mean("rays")
        one = first.setdefault((batch.variant, batch.agent), batch)
        less = Difference(NOTHING, NOTHING) if one is batch else difference(batch, one, PLACE, late)
        excess = np.full(2, np.nan)  # of a method that tells no paths
        if batch.tells_paths:
            excess = np.array([(rays - m[:, :size])[:, late].mean() for m in (mark.rays, mark.likely_rays)])
        rows.append(
            _who(batch)
            | {
                "runs": batch.runs,
                "diverged": batch.diverged,
                "position_settled_rmse_m": _level(position),
                "position_to_known_map_bound": _level(position) / _level(mark.known.position_m[late]),
                "position_to_unknown_map_bound": _level(position) / _level(mark.unknown.position_m[late]),
                "position_settled_standard_error_m": standard_error(squares(batch, PLACE, late)),
                "position_less_first_m": less.value,
                "position_less_first_standard_error_m": less.error,
                "heading_settled_rmse_deg": float(np.degrees(_level(heading))),
                "heading_to_known_map_bound": _level(heading) / _level(mark.known.heading_rad[late]),
                "heading_to_unknown_map_bound": _level(heading) / _level(mark.unknown.heading_rad[late]),
                "heading_settled_standard_error_deg": float(
                    np.degrees(standard_error(squares(batch, "heading_error_rad", late)))
                ),
                "position_settled_nees": float(nees[late].mean()),
                "position_settled_median_nees": float(np.median(batch.steps["position_nees"][:, late])),
                "silent_steps": batch.silent_steps,
                "nees_in_band": float(((low <= nees) & (nees <= high)).mean()),
                "surface_ospa_m": batch.surface_ospa_m,
                "surface_gospa_m": batch.surface_gospa_m,
                "image_ospa_m": float(batch.mapped(batch.mean("image_ospa_m"))[late].mean()),
                "ray_excess": float(excess[0]),
                "likely_ray_excess": float(excess[1]),
                "seconds_per_step": float(
                    np.median([r["agents"][batch.agent]["cost"]["seconds_per_step"] for r in batch.records])
                ),
            }
        )
    return rows


def write_tables(directory: Path, found: Sequence[Batch]) -> list[Path]:
    """Write ``runs.csv``, ``steps.csv`` and ``summary.csv``; an empty cell is a number that there isn't.

    Raises
    ------
    InputError
        They can't be written.
    """
    written = []
    for name, rows in (
        ("runs", run_rows(found)),
        ("steps", step_rows(found)),
        ("summary", summary_rows(found)),
    ):
        written.append(directory / f"{name}.csv")
        write_bytes(written[-1], content(rows))
    return written


def content(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """A table's file."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    return text.getvalue().encode()


def _who(batch: Batch) -> dict[str, Any]:
    settings: Mapping[str, Any] = dict(batch.variant.settings)
    return {"scene": batch.variant.name, **settings, "method": batch.method, "agent": batch.agent}


def _plain(scores: Mapping[str, Any]) -> dict[str, Any]:
    """Those that are numbers."""
    return {key: value for key, value in scores.items() if not isinstance(value, dict)}


def _flat(scores: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Scores with names of their own for those of tables in them, but for what was said in words."""
    for key, value in scores.items():
        if key == "why":
            continue
        if isinstance(value, Mapping):
            yield from ((f"{key}_{inner}", one) for inner, one in _flat(value))
        else:
            yield key, value


def _level(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and np.isnan(value)) else value
