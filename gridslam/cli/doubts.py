"""Command line: what `run` says of recorded measurements that fit scene or truth badly."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gridslam.cli.output import busy
from gridslam.wording import counted, time_span

if TYPE_CHECKING:
    from gridslam.arrays import Array
    from gridslam.maps.map import Map
    from gridslam.measurements.observations import Observations
    from gridslam.runs.run import Run
    from gridslam.world.scene import Scene

UNWELL = 0.1
"""Share of the steps from which on measurements, which weren't simulated, are doubted."""
OFTEN = 0.03
"""Share of sharp steps from which on the scene's motion is called too smooth."""
KNOWN_M, SIGMAS, AROUND_M, PACES = 0.1, 4.0, 0.1, 3.0
"""Deviation up to which a first position is known well; deviations, and metres, that it may be off besides;
steps that an agent may go at once."""


def fit_notes(
    world: Scene, runs: Sequence[Run], observations: Sequence[Observations], file: Path, scene: str
) -> list[str]:
    """What is wrong with the distances, else with the fit; and a true track that isn't of what was heard.

    Parameters
    ----------
    file : Path
        The measurements of the first agent.
    scene : str
        The scene as it was asked for.
    """
    early = early_notes(world, runs, observations)
    notes = _range_notes(world, runs, observations)
    absurd = absurd_notes(runs, observations)
    if notes:  # such distances fit no true track either
        return [*absurd, *notes, *early]
    misfit = list(dict.fromkeys([*absurd, *_misfit_notes(world, runs, observations, file, scene)]))
    about = [*start_notes(world, runs), *course_notes(runs), *truth_notes(world, runs, observations)]
    return [*misfit, *early, *about]


def start_notes(world: Scene, runs: Sequence[Run]) -> list[str]:
    """Whose first poses lie out of what the told start's prior allows, known well from the first step on.

    What leaps at the second step wasn't known at the first.
    """
    import numpy as np

    notes = []
    for run in runs:
        body, begun = world.agent(run.agent), run.estimates[:2]
        spread = [float(np.sqrt(np.trace(one.covariance[:2, :2]))) for one in begun]
        if len(begun) < 2 or max(spread) > KNOWN_M:
            continue
        leap, away = (
            float(np.linalg.norm(begun[0].position_m - place))
            for place in (begun[1].position_m, run.began.position_m)
        )
        doubt = SIGMAS * spread[0] + AROUND_M
        if leap < PACES * body.step_m + doubt and away > np.sqrt(2) * body.prior.position_m + doubt:
            x, y = begun[0].position_m
            notes.append(
                f"{run.agent}: from the first step on the run puts it at ({x:.1f}, {y:.1f}) m, {away:.1f} m "
                f"from the told start, known to {body.prior.position_m:g} m: see start_m, or the anchors"
            )
    return notes


def absurd_notes(runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """What the numbers alone give away: deviations of angles in degrees let anything fit; dead antennas."""
    import numpy as np

    from gridslam.checks.signals.elements import sample_faults
    from gridslam.checks.tables.unit_hypotheses import absurd
    from gridslam.measurements.recording import Recording
    from gridslam.measurements.table import Measurements

    notes = []
    for run, heard in zip(runs, observations, strict=True):
        found: Sequence[object] = []
        if isinstance(heard, Measurements):
            found = absurd({name: np.asarray(values) for name, values in heard.columns.items()})[0]
        elif isinstance(heard, Recording):
            found = sample_faults(heard.samples, heard.heard, heard.anchors)
        notes += [f"{run.agent}: suspect: {item}" for item in found]
    return notes


def course_notes(runs: Sequence[Run]) -> list[str]:
    """Whose heading and direction of motion don't go together."""
    from gridslam.checks.sights.course import course_note

    notes = [(run.agent, course_note(run.estimates)) for run in runs]
    return [f"{agent}: {note}" for agent, note in notes if note is not None]


def early_notes(world: Scene, runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """Whose paths arrive before lines of sight could, from where the run puts the agent."""
    from gridslam.checks.runs.early_arrivals import early_arrivals
    from gridslam.measurements.table import Measurements

    notes = []
    for run, heard in zip(runs, observations, strict=True):
        if not isinstance(heard, Measurements) or world.clocks is not None:
            continue
        early = early_arrivals(run.estimates, heard, world.filter_model(run.agent))
        if early is not None:
            notes.append(
                f"{run.agent}: at {early.steps} of {early.heard} steps a path is shorter than the line of "
                f"sight to where this run puts the agent, by up to {early.short_m:.1f} m (anchor "
                f"{early.anchor}): it was elsewhere, or distances are too short"
            )
    return notes


def radio_notes(world: Scene) -> list[str]:
    """What of the scene's radio can hardly be meant."""
    from gridslam.checks.scene.lines import implausible_radio

    return [f"suspect: {found}" for found in implausible_radio(world)]


def found_notes(runs: Sequence[Run]) -> list[str]:
    """What the scene gives with deviations, as believed at the end: coefficients, heights, anchors."""
    levels = [
        f"{done.agent}: coefficient of the {name} {found:.2f} +-{std:.2f}"
        for done in runs
        for name, (found, std) in (done.estimates[-1].coefficients if done.estimates else {}).items()
    ]
    heights = [
        f"{done.agent}: height of {'the agent' if name == 'agent' else f'the {name}'} "
        f"{height:.3f} m +-{std:.3f}"
        for done in runs
        for name, (height, std) in (done.estimates[-1].heights if done.estimates else {}).items()
    ]
    anchors = [
        f"{done.agent}: anchor {name} stands at ({one.position_m[0]:.2f}, {one.position_m[1]:.2f}) m "
        f"+-{one.position_std_m:.2f}, turned to {math.degrees(one.orientation_rad):.1f} "
        f"+-{math.degrees(one.orientation_std_rad):.1f} degrees"
        for done in runs
        for name, one in (done.estimates[-1].anchors if done.estimates else {}).items()
    ]
    return levels + heights + anchors


def jolt_notes(world: Scene, runs: Sequence[Run]) -> list[str]:
    """Whose motion the scene's filter settings are too narrow for, and how wide they were taken."""
    from gridslam.runs.hurries import hurry

    settings, notes = world.filter, []
    for run in runs:
        jolts = [one.health.jolt for one in run.estimates if max(one.health.jolt) > 1]
        if len(jolts) > OFTEN * len(run.estimates):
            push, turn = (max(factors) for factors in zip(*jolts, strict=True))
            notes.append(
                f"{run.agent}: at {len(jolts)} of {len(run.estimates)} steps it moved more sharply "
                f"than filter.acceleration_mps2 = {settings.acceleration_mps2:g} and filter.heading_deg = "
                f"{settings.heading_deg:g} say; up to {push * settings.acceleration_mps2:.2g} and "
                f"{turn * settings.heading_deg:.2g} were allowed there. Set them to how it moves"
            )
        elif (hurried := hurry(run.estimates, settings.acceleration_mps2)) is not None:
            share, acceleration = hurried
            notes.append(
                f"{run.agent}: at {share:.0%} of the steps its velocity had changed, within ten steps, over "
                f"three times as much as filter.acceleration_mps2 = {settings.acceleration_mps2:g} expects: "
                f"it may have lost the agent at bends. {acceleration:.1g} allows for them"
            )
    return notes


def element_notes(runs: Sequence[Run]) -> list[str]:
    """Whose antenna elements aren't as the recording says, by how much, and what that costs."""
    return [
        f"{run.agent}: antenna elements are off by {size:.0%} of what the recording says (root mean square): "
        "taken out but for what looks like a direction, so that angles count for less. Calibrate the arrays"
        for run in runs
        if run.estimates and (size := run.estimates[-1].health.elements)
    ]


def map_notes(earlier: Map | None, later: Map, file: Path | None) -> list[str]:
    """Where a map that was given, and the map that was made of it, contradict each other, or count twice."""
    from gridslam.maps.contradictions import contradictions, moved_walls
    from gridslam.maps.run_identity import alike_runs

    if earlier is None:
        return []
    moved = moved_walls(earlier, later, str(file))
    apart = contradictions([earlier, later], [str(file), "this run's map"])
    return [*apart, *filter(None, [moved]), *alike_runs(later)]


def whole_walls_notes(runs: Sequence[Run]) -> list[str]:
    """That their method can't tell where walls are open, and where nothing was heard off them in between."""
    from gridslam.runs.notes import whole_walls_note
    from gridslam.runs.unhit import unhit, unhit_words

    note = whole_walls_note(runs[-1].map, runs[-1].method)
    return [] if note is None else [note + unhit_words(unhit(runs[-1].map.wall_segments()))]


def heading_notes(world: Scene, runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """Whose headings nothing tells, which tracks can't say of themselves."""
    from gridslam.evaluation.ground_truth import untold_heading
    from gridslam.systems.registry import METHODS

    each = zip(runs, observations, strict=True)
    said = [
        (run.agent, untold_heading(world, run.agent, heard)) for run, heard in each if run.method in METHODS
    ]
    return [f"{name}: {why}" for name, why in said if why]


def silence_notes(
    world: Scene,
    earlier: Map | None,
    runs: Sequence[Run],
    observations: Sequence[Observations],
    file: Path | None,
) -> list[str]:
    """Where nothing was heard for long, or of headings; which anchors by an earlier map should be heard."""
    from gridslam.checks.runs.silent_sights import silent_sights
    from gridslam.measurements.table import Measurements
    from gridslam.runs.notes import silence_note

    long = [silence_note(run.agent, run.unheard, len(run.estimates)) for run in runs]
    notes = [*(note for note in long if note), *heading_notes(world, runs, observations)]
    for run, heard in zip(runs, observations, strict=True):
        if earlier is None or not isinstance(heard, Measurements):
            continue
        for name, expected, silent in silent_sights(
            run.estimates, heard, earlier, world.filter_model(run.agent), run.map
        ):
            notes.append(
                f"{run.agent}: by {file} anchor {name} is in sight at {expected} steps, and wasn't heard at "
                f"{silent} of them: a door has shut, or it was silent. Cells between stay free in the map"
            )
    return notes


def _range_notes(world: Scene, runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """What they show of their distances: clocks, or heights.

    Nothing where an agent moved as none can: names that are exchanged in mid-run look like a clock, too.
    """
    from gridslam.checks.runs.range_note import range_note
    from gridslam.inference.health.reasons import LEAPT

    with busy("looking at the distances"):
        notes = [
            (done.agent, range_note(world, done.agent, h))
            for done, h in zip(runs, observations, strict=True)
            if not any(LEAPT in one.health.why for one in done.estimates)
        ]
    return [f"{agent}: {note}" for agent, note in notes if note]


def _misfit_notes(
    world: Scene, runs: Sequence[Run], observations: Sequence[Observations], file: Path, scene: str
) -> list[str]:
    """What `check` suspects: of all where filters were unwell or nothing fits, else of times and amplitudes.

    A filter may be well on exchanged anchors: it maps another world, and is sure of it. Where nothing is
    suspected of a misfit, the note says who looks closer.
    """
    import numpy as np

    from gridslam.checks.runs.range_note import fits_scene, misfits, misread

    asked = shlex.join(["gridslam", "check", str(file), "--scene", scene])
    doubted, notes = [], []
    for run, observed in zip(runs, observations, strict=True):
        unwell = bool(np.mean([not one.health.ok for one in run.estimates] or [False]) > UNWELL)
        with busy("looking at lines of sight"):
            unfit = unwell or not fits_scene(world, run.agent, observed)
            found = (misfits if unfit else misread)(world, run.agent, observed)
            notes += [f"{run.agent}: suspect: {line}" for line in found]
            if unfit and not found:
                doubted.append(run.agent)
    if doubted:
        whole = f"{', '.join(doubted)}: whether units, angles and anchors' names fit is told by: {asked}"
        notes.append(whole)
    return notes


def truth_notes(world: Scene, runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """Where the errors of the table are those of another track."""
    from gridslam.checks.runs.truth_fit import truth_note

    pairs = list(zip(runs, observations, strict=True))
    found = [(run.agent, truth_note(world, run.agent, observed)) for run, observed in pairs]
    notes = [f"{agent}: {note}" for agent, note in found if note]
    for run, observed in pairs:
        holes = [] if observed.truth is None else observed.truth.holes().tolist()
        spans = [span for span in holes if _within(run.trajectory.time_s, *span)]
        if spans:
            more = f", and in {counted(len(spans) - 1, 'other hole')}" * (len(spans) > 1)
            notes.append(
                f"{run.agent}: the true track has no pose from {time_span(*spans[0])}{more}: "
                "steps in between aren't scored"
            )
    return notes


def _within(time_s: Array, first: float, last: float) -> bool:
    """Whether any of the times (N,) lies between two."""
    return bool(((time_s > first) & (time_s < last)).any())


def unknown_notes(world: Scene, runs: Sequence[Run], observations: Sequence[Observations]) -> list[str]:
    """Whose true tracks lack, where surfaces and map of all are scored by what the others could hear."""
    known = [run.agent for run, one in zip(runs, observations, strict=True) if one.truth is not None]
    others = [run.agent for run in runs if run.agent not in known]
    if not (world.walls and known and others):
        return []
    return [
        f"surfaces and map, which are of all agents, are scored by what {' and '.join(known)} alone could "
        f"hear: no true track of {' and '.join(others)} is given"
    ]
