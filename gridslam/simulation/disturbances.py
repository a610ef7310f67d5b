"""What goes wrong in the real world, as functions that turn a simulated case into a disturbed one.

Changes of the world or of the way (`triples`, `diffuse`, `glancing`, `strides`) simulate anew, so they come
before those of what was heard (`silence`, `clutter_burst`) and of what the filter is told (`stated_clutter`,
`stated_snr`, `stated_orientation`, `vague_start`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.measurements.table import Measurements
from gridslam.simulation.image_source import TruePaths, measured_along, true_paths
from gridslam.simulation.unusual_paths import diffuse_points, grazing, triple_bounces
from gridslam.world.columns import KEYS, OPTIONAL, VALUES
from gridslam.world.scene import Scene
from gridslam.world.trajectory import Trajectory
from gridslam.world.waypoints import TightCorner, smooth_track

STREAM = 0xD1


@dataclass(frozen=True, eq=False)
class Case:
    """A world, what an agent heard on its way, and what the filter is told.

    Attributes
    ----------
    scene : Scene
        The world as it is.
    believed : Scene
        What the filter is told: no walls, and possibly wrong numbers.
    agent : str
    seed : int
    track : Trajectory
        The true way.
    paths : TruePaths
        What a filter could have used: visible paths of up to ``max_bounces``, as strong as they are, without
        those of silent steps.
    measurements : Measurements
    first, last : int
        Steps ``first`` to ``last - 1`` are disturbed; both 0 if none is, ``last`` at the end if all are.
    """

    scene: Scene
    believed: Scene
    agent: str
    seed: int
    track: Trajectory
    paths: TruePaths
    measurements: Measurements
    first: int = 0
    last: int = 0

    def draw(self) -> np.random.Generator:
        """Random numbers of the disturbance, apart from the simulator's."""
        return np.random.default_rng([self.seed, STREAM])


def undisturbed(scene: Scene, agent: str | None = None, seed: int = 0) -> Case:
    """The scene as simulated; the filter is told everything but the walls and the way."""
    agent = scene.agents[0].name if agent is None else agent
    track, paths = scene.track(agent), true_paths(scene, agent)
    measurements, _ = measured_along(scene, agent, track, paths, seed)
    data = scene.model_dump(exclude_none=True)
    data["agents"] = [
        {k: v for k, v in a.items() if k not in ("waypoints_m", "steps")} for a in data["agents"]
    ]
    believed = Scene.checked({**data, "walls": []}, scene.name)
    return Case(scene, believed, agent, seed, track, paths, measurements)


def silence(case: Case, first: int, steps: int) -> Case:
    """Nothing is heard for `steps` steps."""
    last = _last(case, first, steps)
    quiet = (case.measurements.step >= first) & (case.measurements.step < last)
    silent = (case.paths.step >= first) & (case.paths.step < last)
    measurements = _with_columns(
        case.measurements, {n: v[~quiet] for n, v in _columns(case.measurements).items()}
    )
    return replace(case, measurements=measurements, paths=case.paths.take(~silent), first=first, last=last)


def clutter_burst(case: Case, first: int, steps: int, times: float = 10.0) -> Case:
    """Clutter at `times` its usual level for `steps` steps, at all anchors."""
    last, draw, signal = _last(case, first, steps), case.draw(), case.scene.signal_model(case.agent)
    anchors = len(case.scene.anchors)
    counts = draw.poisson((times - 1) * signal.false_alarms, (last - first, anchors)).ravel()
    total, cell = int(counts.sum()), np.repeat(np.arange(counts.size), counts)
    step = first + cell // anchors
    more = {
        "step": step,
        "time_s": case.track.time_s[step],
        "anchor": cell % anchors,
        "distance_m": draw.uniform(0, signal.max_distance_m, total),
        "aod_rad": draw.uniform(-np.pi, np.pi, total),
        "aoa_rad": draw.uniform(-np.pi, np.pi, total),
        # Rayleigh with scale^2 = 1/2 above the threshold, by inversion
        "amplitude": np.sqrt(signal.threshold**2 + draw.exponential(1.0, total)),
    }
    whole = {name: np.concatenate([v, more[name]]) for name, v in _columns(case.measurements).items()}
    order = np.lexsort((whole["distance_m"], whole["anchor"], whole["step"]))
    measurements = _with_columns(case.measurements, {name: v[order] for name, v in whole.items()})
    return replace(case, measurements=measurements, first=first, last=last)


def stated_clutter(case: Case, times: float) -> Case:
    """The filter is told `times` the true clutter level."""
    return _with_radio(case, {"false_alarms": times * case.scene.radio.false_alarms})


def stated_snr(case: Case, times: float) -> Case:
    """The filter is told `times` the true SNR (a power ratio)."""
    return _with_radio(case, {"snr_at_1m_db": case.scene.radio.snr_at_1m_db + 10 * np.log10(times)})


def stated_orientation(case: Case, turn_deg: float = 2.0, anchor: int = 0) -> Case:
    """The filter takes an anchor to be turned by `turn_deg` more than it is."""
    data = case.believed.model_dump(exclude_none=True)
    data["anchors"][anchor]["orientation_deg"] += turn_deg
    believed = Scene.checked(data, case.scene.name)
    measurements = replace(case.measurements, anchor_orientation_rad=believed.anchor_orientations)
    return _throughout(replace(case, believed=believed, measurements=measurements))


def vague_start(case: Case, position_m: float = 2.0, heading_deg: float = 30.0) -> Case:
    """The start is known within `position_m` per axis and `heading_deg` alone, and told wrong accordingly.

    The disturbance ends at step 1: what comes after is the filter's to mend.
    """
    draw, data = case.draw(), case.believed.model_dump(exclude_none=True)
    own = next(a for a in data["agents"] if a["name"] == case.agent)
    prior = {**own.get("prior", {}), "position_m": position_m, "heading_deg": heading_deg}
    low, high = np.transpose([case.scene.grid.x_m, case.scene.grid.y_m])
    start = np.clip(case.track.position_m[0] + draw.uniform(-position_m, position_m, 2), low, high)
    facing = np.degrees(case.track.heading_rad[0]) + draw.uniform(-heading_deg, heading_deg)
    own |= {"start_m": start.tolist(), "start_heading_deg": float(facing), "prior": prior}
    true = case.scene.model_dump(exclude_none=True)
    for agent in true["agents"]:
        if agent["name"] == case.agent:
            agent["prior"] = prior  # what the bound may count on
    return replace(
        case,
        scene=Scene.checked(true, case.scene.name),
        believed=Scene.checked(data, case.scene.name),
        first=0,
        last=1,
    )


def triples(case: Case) -> Case:
    """Paths over three walls are heard besides."""
    return _again(case, case.paths, triple_bounces(case.scene, case.agent, case.track))


def diffuse(case: Case, count: int = 6, size_m: float = 0.8) -> Case:
    """Small things that scatter to all sides are heard besides."""
    more = diffuse_points(case.scene, case.agent, case.track, count, size_m, case.draw())
    return _again(case, case.paths, more)


def glancing(case: Case, share: float = 0.56) -> Case:
    """Coefficients grow towards grazing incidence, from `share` of the material's at normal incidence."""
    return _again(case, grazing(case.scene, case.paths, share))


def strides(case: Case, times: int = 10, steps: int = 150, pause: bool = False) -> Case:
    """The agent goes round its waypoints `times` as far per step, which its scene's ``step_m`` tells.

    Parameters
    ----------
    times : int
        Steps of the original way that make one.
    steps : int
        How many to go.
    pause : bool
        Whether a stride takes `times` as long (a receiver that listens seldom); otherwise the agent is
        `times` as fast, and turns and accelerates beyond what the filter assumes.
    """
    body = case.scene.agent(case.agent)
    once = smooth_track(body.way, body.step_m, body.interval_s, body.acceleration_mps2)
    rounds = 1 + int(np.ceil(steps * times / len(once)))
    way = np.concatenate([body.way] * (2 * rounds))
    try:
        walk = smooth_track(way, body.step_m, body.interval_s, body.acceleration_mps2)
    except TightCorner as error:
        where = f"{case.scene.name}: agents: {case.agent}: waypoints_m"
        raise InputError(where, str(error), "a way that can be gone round and round") from None
    rows = slice(0, steps * times, times)
    interval = body.interval_s * (times if pause else 1)
    speed = walk.velocity_mps[rows] * (1 if pause else times)
    time = interval * np.arange(len(speed), dtype=np.float64)
    high = None if body.height_m is None else np.full(len(time), body.height_m)
    track = Trajectory(time, walk.position_m[rows], speed, walk.heading_rad[rows], high)
    data = case.believed.model_dump(exclude_none=True)
    own = next(a for a in data["agents"] if a["name"] == case.agent)
    own |= {"step_m": body.step_m * times, "interval_s": interval}
    believed = Scene.checked(data, case.scene.name)
    paths = true_paths(case.scene, case.agent, track)
    return _again(replace(case, track=track, believed=believed), paths)


def _again(case: Case, paths: TruePaths, more: TruePaths | None = None) -> Case:
    """The case with other paths heard throughout; `more` are heard without counting for the bound."""
    whole = paths if more is None else paths.joined(more)
    measurements, _ = measured_along(case.scene, case.agent, case.track, whole, case.seed)
    interval = case.believed.agent(case.agent).interval_s
    return _throughout(replace(case, paths=paths, measurements=replace(measurements, interval_s=interval)))


def _with_radio(case: Case, radio: Mapping[str, Any]) -> Case:
    data = case.believed.model_dump(exclude_none=True)
    believed = Scene.checked({**data, "radio": {**data["radio"], **radio}}, case.scene.name)
    return _throughout(replace(case, believed=believed))


def _throughout(case: Case) -> Case:
    return replace(case, first=0, last=len(case.track))


def _last(case: Case, first: int, steps: int) -> int:
    if not 0 <= first < first + steps <= len(case.track):
        raise InputError(
            "disturbance", f"steps {first} to {first + steps}", f"steps in 0 to {len(case.track)}"
        )
    return first + steps


def _columns(measurements: Measurements) -> dict[str, Array]:
    names = (*KEYS, *VALUES, *(n for n in OPTIONAL if getattr(measurements, n) is not None))
    return {name: getattr(measurements, name) for name in names}


def _with_columns(measurements: Measurements, columns: dict[str, Array]) -> Measurements:
    rest = {f.name: getattr(measurements, f.name) for f in fields(Measurements) if f.name not in columns}
    return Measurements(**{**rest, **columns})
