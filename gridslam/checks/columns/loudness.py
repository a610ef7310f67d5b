"""Whether amplitudes are what they are called, by lines of sight: the level, decibels, powers."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from gridslam.arrays import Array
from gridslam.checks.sights.line_of_sight_filter import Sight
from gridslam.checks.tables.unit_hypotheses import ADVICE, Suspicion
from gridslam.world.scene import Scene

ENOUGH, CERTAIN = 10.0, 30.0
"""Log likelihood ratios in nats above which a reading is told, and told as certain."""
LEVEL_DB = 2.5
"""Amplitudes whose level is nearer to the expected one aren't questioned."""
FAINTER_DB, LOUDER_DB, ENOUGH_SIGHTS = 5.5, 4.5, 30
"""A level so far below or above the expected one is told, if so many lines of sight have it: what is taken
for one may be a reflection, which is fainter, and never louder. An amplitude that is twice another has 6 dB
more."""
ENOUGH_ROWS, FAINTEST = 200, 0.02
"""Measurements, and the share of them that must be nearly as faint as can be, for a threshold to be seen."""
LEAST_DB = 15.0
"""Median from which on decibels are told by their course alone: logarithms of less scatter more than that."""
SHIFTS_M = (-4.0, -2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0, 4.0)
"""Errors of all distances that might be why amplitudes don't fit."""

SPREADS, STRAYS = (0.1, 0.2), (0.2, 0.4)
"""Of log amplitudes about their level, and the share that may be anything: in a corridor, say, reflections
that are as long as lines of sight, but fainter, which a radio of little noise tells from them."""


class Likeliest(NamedTuple):
    """The reading of amplitudes that explains most.

    Attributes
    ----------
    kind : str
        As of `ADVICE`; empty: as they stand.
    gain : float
        Log likelihood ratio to how they stand, nats.
    by_course : bool
        Whether they are decibels by how they fall with the distance, whatever their level.
    likelihood, asis : float
        Log likelihoods of what is measured, so read and as it stands, nats.
    """

    kind: str
    gain: float
    by_course: bool
    likelihood: float
    asis: float


def loudness(amplitude: Array, sight: Sight, scene: Scene, placed: bool = True) -> list[Suspicion]:
    """Amplitudes of the lines of sight against one over the distance, the level being known to some 4 dB.

    Parameters
    ----------
    amplitude : (K,) array
        Of the table's rows; NaN where not measured.
    sight : Sight
        Its lines of sight.
    scene : Scene
    placed : bool
        Whether angles tell where the agent is. By distances alone reflections pass for lines of sight, but
        fainter and by another course: only where amplitudes begin tells how to read them, and in a scene
        with walls their level.
    """
    rows, near = sight.row[sight.sure], sight.distance_m[sight.sure]
    with np.errstate(invalid="ignore"):
        good = (amplitude[rows] > 0) & (near > 0)
    loud, near = amplitude[rows][good], near[good]
    if len(loud) < 10:
        return []
    off = np.log(loud) - np.log(scene.signal_model().amplitude(near))
    level = 20 / np.log(10) * float(np.median(off))
    best = _likeliest(loud, near, scene)
    # numbers that begin where the radio begins to detect are amplitudes, whatever is taken for lines of sight
    right = _at_threshold(amplitude, "", scene)
    begins = best.gain > 0 and not right and _at_threshold(amplitude, best.kind, scene)
    misread = begins or (placed and (best.by_course or (not right and _sure(best, level))))
    shown = f"{len(loud)} lines of sight are {level:+.0f} dB off as it stands"
    told = (placed or scene.walls) and not best.by_course and len(loud) >= ENOUGH_SIGHTS
    if told and not -FAINTER_DB < level < LOUDER_DB:
        if not misread or (not begins and _course(off) > best.likelihood):
            stated, way = scene.radio.snr_at_1m_db, "low" if level > 0 else "high"
            text = f"the scene's radio.snr_at_1m_db of {stated:g} dB is too {way}: {stated + level:.0f} fits"
            reason = f"{shown}; or it is {ADVICE[best.kind]}" if best.kind else shown
            return [Suspicion("amplitude", "level", text, False, reason)]
    if not misread:
        return []
    reason = f"{shown}; log likelihood ratio {best.gain:.0f}"
    reason += "; so read, the faintest are at the scene's radio.detection_threshold_db" if begins else ""
    return [Suspicion("amplitude", best.kind, ADVICE[best.kind], best.gain > CERTAIN or begins, reason)]


def _likeliest(loud: Array, near: Array, scene: Scene) -> Likeliest:
    """The likeliest reading of amplitudes (N,) at distances (N,) in m."""
    expected = np.log(scene.signal_model().amplitude(near))
    readings = {"": np.log(loud), "dB": loud * np.log(10) / 20, "power": 0.5 * np.log(loud)}
    scores = {kind: _level(values - expected) for kind, values in readings.items()}
    kind = max(scores, key=lambda name: scores[name])
    gain = scores[kind] - scores[""]
    if kind == "power":  # distances that are all off bend the same curve
        moved = (near - shift for shift in SHIFTS_M if (near > shift).all())
        bent = (_level(readings[""] - np.log(scene.signal_model().amplitude(true))) for true in moved)
        gain = scores[kind] - max([scores[""], *bent])
    # decibels may be as large as what they stand for; their course with the distance isn't
    course = _course(readings["dB"] - expected) - _course(readings[""] - expected)
    by_course = course >= ENOUGH and float(np.median(loud)) >= LEAST_DB
    if by_course:
        kind, gain = "dB", max(course, gain if kind == "dB" else course)
    # logarithms spread more or less than what they are read as does, so densities of either aren't alike:
    # small numbers read as decibels all lie near each other, whatever they are
    stretch = {"": 0.0, "power": -np.log(2) * len(loud), "dB": np.log(readings["dB"]).sum()}
    return Likeliest(kind, gain, by_course, float(scores[kind] + stretch[kind]), scores[""])


def _sure(best: Likeliest, level_db: float) -> bool:
    """Whether another reading explains clearly more; powers are asked for only where the level is off."""
    off = abs(level_db) >= LEVEL_DB
    enough = ENOUGH if off or best.kind != "dB" else CERTAIN
    return (off or best.kind == "dB") and best.gain >= enough and best.likelihood - best.asis >= ENOUGH


def _at_threshold(amplitude: Array, kind: str, scene: Scene) -> bool:
    """Whether a reading of the amplitudes begins where the scene's radio begins to detect paths."""
    decibels, measured = scene.radio.detection_threshold_db, amplitude[np.isfinite(amplitude)]
    first = {"": 10 ** (decibels / 20), "dB": decibels, "power": 10 ** (decibels / 10)}[kind]
    if len(measured) < ENOUGH_ROWS or first <= 0:
        return False
    return bool(measured.min() > 0.98 * first and np.quantile(measured, FAINTEST) < 1.1 * first)


def _course(gap: Array) -> float:
    """Log likelihood of log amplitudes by their course with the distance alone, whatever their level."""
    return _level(gap - np.median(gap))


def _level(gap: Array) -> float:
    """Log likelihood of log amplitudes off by one common level (std 0.5); a share of them may be anything."""
    levels = np.linspace(-1.5, 1.5, 61)
    scores = []
    for spread, stray in product(SPREADS, STRAYS):
        near = np.exp(-0.5 * ((gap - levels[:, None]) / spread) ** 2) / (np.sqrt(2 * np.pi) * spread)
        each = np.log((1 - stray) * near + stray / 6).sum(1) - 0.5 * (levels / 0.5) ** 2
        scores.append(np.logaddexp.reduce(each))
    return float(np.logaddexp.reduce(scores) - np.log(len(scores)))
