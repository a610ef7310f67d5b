"""What disturbances do to a filter: each case with and without, in bounds, and whether the filter says so."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np

from gridslam.arrays import Array
from gridslam.errors import InputError
from gridslam.estimates import Estimate
from gridslam.evaluation.bounds import known_map_bound
from gridslam.evaluation.consistency import complaints
from gridslam.runs.map_scene import map_scene
from gridslam.simulation import disturbances
from gridslam.simulation.disturbances import Case
from gridslam.systems.registry import DEFAULT
from gridslam.systems.slam import Slam
from gridslam.world.scene import Scene

FIRST = 60
"""Step at which a passing disturbance begins: the map is there by then."""
MEND = 50
"""Steps within which a filter should have recovered."""
RECOVERED, RUNNING = 2.0, 10
"""Times the bound that counts as recovered, over so many steps."""
WARM_UP = 20


@dataclass(frozen=True)
class Kind:
    """A kind of disturbance.

    Attributes
    ----------
    description : str
        In words.
    apply : callable
        Case to disturbed case.
    scenes : tuple of str
        Where it makes sense.
    """

    description: str
    apply: Callable[[Case], Case]
    scenes: tuple[str, ...] = ("room", "alcove")


KINDS: dict[str, Kind] = {
    "none": Kind("nothing", lambda case: case),
    "silence": Kind("30 silent steps", lambda case: disturbances.silence(case, FIRST, 30)),
    "burst": Kind("clutter x 10 for 20 steps", lambda case: disturbances.clutter_burst(case, FIRST, 20)),
    "clutter-double": Kind("told twice the clutter", lambda case: disturbances.stated_clutter(case, 2.0)),
    "clutter-half": Kind("told half the clutter", lambda case: disturbances.stated_clutter(case, 0.5)),
    "snr-double": Kind("told twice the SNR", lambda case: disturbances.stated_snr(case, 2.0)),
    "snr-half": Kind("told half the SNR", lambda case: disturbances.stated_snr(case, 0.5)),
    "grazing": Kind("coefficients 0.39 to 0.93 by incidence", disturbances.glancing),
    "triple": Kind("triple bounces", disturbances.triples),
    "diffuse": Kind("6 diffuse points", disturbances.diffuse),
    "strides": Kind("steps of 0.5 m, ten times as fast", disturbances.strides, ("room",)),
    "strides-slow": Kind(
        "steps of 0.5 m, ten times as long", lambda case: disturbances.strides(case, pause=True), ("room",)
    ),
    "start": Kind("start known to 2 m and 30 degrees", disturbances.vague_start),
    "orientation": Kind("anchor told 2 degrees off", disturbances.stated_orientation),
    "flat": Kind("without the curved wall", lambda case: case, ("canyon",)),
    "curved": Kind("curved wall in facets", lambda case: case, ("canyon",)),
}
AGENTS = {"canyon": "agent2"}
"""Whose way leads along what the case is about; elsewhere the first agent's."""


@dataclass(frozen=True)
class Result:
    """One run; ratios are root mean squares over a stretch, error over known-map bound.

    Attributes
    ----------
    scene, case, agent : str
    seed, first, last : int
        Steps ``first`` to ``last - 1`` are disturbed.
    before, during, after : float
        Ratios from step 20 on, under the disturbance, and from 50 steps after it (or after the start, if all
        is disturbed) to the end; NaN where there is no such stretch.
    recovered_after : int
        Steps from the end of the disturbance (or the start) until the ratio over ten steps is 2 or less;
        -1 if never.
    unwell_before, unwell_during, unwell_after : float
        Share of these stretches in which health isn't ok.
    why : str
        The most frequent reason.
    finite : bool
        Whether all estimates are.
    surfaces : int
        Detected at the end.
    seconds_per_step : float
    """

    scene: str
    case: str
    agent: str
    seed: int
    first: int
    last: int
    before: float
    during: float
    after: float
    recovered_after: int
    unwell_before: float
    unwell_during: float
    unwell_after: float
    why: str
    finite: bool
    surfaces: int
    seconds_per_step: float

    @property
    def good(self) -> bool:
        """Recovered, or said that it hasn't."""
        return self.finite and (self.after <= RECOVERED or self.unwell_after >= 0.5)


def plan(scenes: Sequence[str], cases: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of scene and case that make sense.

    Raises
    ------
    InputError
        An unknown case, or none that goes with these scenes.
    """
    for case in cases:
        if case not in KINDS:
            raise InputError("--case", repr(case), ", ".join(KINDS))
    pairs = [(s, c) for s in scenes for c in cases or KINDS if s in KINDS[c].scenes]
    if not pairs:
        allowed = "; ".join(f"{c}: {', '.join(KINDS[c].scenes)}" for c in cases or KINDS)
        raise InputError("--scene", ", ".join(scenes), allowed)
    return pairs


def study(
    pairs: Sequence[tuple[str, str]], seeds: Sequence[int], method: str | type[Slam] = DEFAULT
) -> Iterator[Result]:
    """Run all pairs of scene and case with all seeds, one after the other."""
    for name, kind in pairs:
        scene = Scene.load(name)
        if kind == "flat":
            flat = tuple(wall for wall in scene.walls if wall.arc is None)
            scene = scene.model_copy(update={"walls": flat})
        for seed in seeds:
            case = KINDS[kind].apply(disturbances.undisturbed(scene, AGENTS.get(name), seed))
            yield run_case(case, kind, method)


def run_case(case: Case, name: str, method: str | type[Slam] = DEFAULT) -> Result:
    """Run a filter on a case and judge it."""
    run = map_scene(case.believed, case.measurements, method, case.agent, case.seed, start="exact")
    return judged(case, name, run.estimates, len(run.surfaces), run.seconds_per_step)


def judged(
    case: Case, name: str, estimates: Sequence[Estimate], surfaces: int = 0, seconds: float = math.nan
) -> Result:
    """Compare the estimates of all steps with the truth and with what can be reached."""
    bound = known_map_bound(case.scene, case.agent, case.paths, case.track).position_m
    error = np.linalg.norm(np.array([e.position_m for e in estimates]) - case.track.position_m, axis=1)
    finite = all(np.isfinite(e.position_m).all() and np.isfinite(e.covariance).all() for e in estimates)
    unwell = np.array([not e.health.ok for e in estimates])
    whole = case.last - case.first == len(error)
    end = 0 if whole else case.last
    stretches = (slice(WARM_UP, case.first), slice(case.first, case.last), slice(end + MEND, None))
    why = next(iter(complaints(estimates)), "")
    before, during, after = (_ratio(error[s], bound[s]) for s in stretches)
    quiet = [float(unwell[s].mean()) if unwell[s].size else math.nan for s in stretches]
    return Result(
        case.scene.name, name, case.agent, case.seed, case.first, case.last, before, during, after,
        _recovery(error[end:], bound[end:]), quiet[0], quiet[1], quiet[2],
        why, finite, surfaces, seconds,
    )  # fmt: skip


def table(results: Sequence[Result]) -> bytes:
    """All results as CSV."""
    text = io.StringIO()
    names = [field.name for field in fields(Result)]
    writer = csv.DictWriter(text, [*names, "good"], lineterminator="\n")
    writer.writeheader()
    for result in results:
        row = {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in asdict(result).items()}
        writer.writerow({**row, "good": result.good})
    return text.getvalue().encode()


def _ratio(error: Array, bound: Array) -> float:
    if not len(error):
        return math.nan
    return float(np.sqrt((error**2).mean() / (bound**2).mean()))


def _recovery(error: Array, bound: Array) -> int:
    """First step from which ten steps together lie within twice the bound, -1 if none."""
    for step in range(len(error) - RUNNING + 1):
        part = slice(step, step + RUNNING)
        if _ratio(error[part], bound[part]) <= RECOVERED:
            return step
    return -1
