"""Whether amplitudes are what they are called, by lines of sight: the level, decibels, powers."""

from __future__ import annotations

from itertools import product

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


def loudness(amplitude: Array, sight: Sight, scene: Scene, placed: bool = True) -> list[Suspicion]:
    """Amplitudes of the lines of sight against one over the distance, the level being known to some 4 dB.

    Parameters
    ----------
    placed : bool
        Whether angles tell where the agent is. By distances alone reflections pass for lines of sight, but
        fainter and by another course: only where amplitudes begin tells how to read them, and in a scene
        with walls their level.
    """
    rows = sight.row[sight.sure]
    near = sight.distance_m[sight.sure]
    with np.errstate(invalid="ignore"):
        good = (amplitude[rows] > 0) & (near > 0)
    loud, near = amplitude[rows][good], near[good]
    if len(loud) < 10:
        return []
    expected = np.log(scene.signal_model().amplitude(near))
    readings = {"": np.log(loud), "dB": loud * np.log(10) / 20, "power": 0.5 * np.log(loud)}
    scores = {kind: _level(values - expected) for kind, values in readings.items()}
    kind = max(scores, key=lambda name: scores[name])
    gain = scores[kind] - scores[""]
    if kind == "power":  # distances that are all off bend the same curve
        moved = (near - shift for shift in SHIFTS_M if (near > shift).all())
        bent = (_level(readings[""] - np.log(scene.signal_model().amplitude(true))) for true in moved)
        gain = scores[kind] - max([scores[""], *bent])
    off = readings[""] - expected
    level = 20 / np.log(10) * float(np.median(off))
    shown = f"{len(loud)} lines of sight are {level:+.0f} dB off as it stands"
    stated, way = scene.radio.snr_at_1m_db, "low" if level > 0 else "high"
    louder = f"the scene's radio.snr_at_1m_db of {stated:g} dB is too {way}: {stated + level:.0f} fits"
    # decibels may be as large as what they stand for; their course with the distance isn't
    course = _course(readings["dB"] - expected) - _course(off)
    if decibels := course >= ENOUGH and float(np.median(loud)) >= LEAST_DB:
        kind, gain = "dB", max(course, gain if kind == "dB" else course)
    misread = bool(kind) and gain >= (ENOUGH if abs(level) >= LEVEL_DB or kind != "dB" else CERTAIN)
    misread &= abs(level) >= LEVEL_DB or kind == "dB"
    # numbers that begin where the radio begins to detect are amplitudes, whatever is taken for lines of sight
    misread &= not _at_threshold(amplitude, "", scene)
    begins = gain > 0 and _at_threshold(amplitude, kind, scene) and not _at_threshold(amplitude, "", scene)
    misread |= decibels or (bool(kind) and begins)
    misread &= placed or begins
    # logarithms spread more or less than what they are read as does, so densities of either aren't alike:
    # small numbers read as decibels all lie near each other, whatever they are
    stretch = {"": 0.0, "power": -np.log(2) * len(loud), "dB": np.log(readings["dB"]).sum()}
    if kind and not begins and not decibels:
        misread &= scores[kind] + stretch[kind] - scores[""] >= ENOUGH
    far_off = not -FAINTER_DB < level < LOUDER_DB
    if (placed or scene.walls) and not decibels and far_off and len(loud) >= ENOUGH_SIGHTS:
        if not misread or (not begins and _level(off - np.median(off)) > scores[kind] + stretch[kind]):
            reason = f"{shown}; or it is {ADVICE[kind]}" if kind else shown
            return [Suspicion("amplitude", "level", louder, False, reason)]
    if not misread:
        return []
    reason = f"{shown}; log likelihood ratio {gain:.0f}"
    reason += "; so read, the faintest are at the scene's radio.detection_threshold_db" if begins else ""
    return [Suspicion("amplitude", kind, ADVICE[kind], gain > CERTAIN or begins, reason)]


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
