"""Clocks that drift where a scene lets them walk alone, or believed rates, by their offsets over a run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.runs.clock_track import ClockTrack
from gridslam.world.clocks import NS
from gridslam.world.network_scene import clock_model
from gridslam.world.scene import Scene

SURE, STRAIGHT = 6.0, 0.95
"""Deviations of a walk as the scene tells it that a rate must have, and how much of the offsets' course must
be a straight line: a jump's is less."""
SETTLED, LEAST_STEPS, PARTS = 20, 20, 12
"""Steps at the beginning that aren't looked at; of a stretch, at least; stretches that a run is cut into. Of
a clock that soon leaves its prior, as far as a filter follows it, one stretch alone tells."""


def drift_note(scene: Scene, track: ClockTrack) -> str | None:
    """One line on clocks whose offsets grow steadily by more than walks explain; None if there are none.

    Parameters
    ----------
    scene : Scene
        With clocks.
    track : ClockTrack
        Of a run of network SLAM.
    """
    if scene.clocks is None:
        return None
    model = clock_model(scene, track.device[track.anchors :])
    rates = _rates(track, model.known, model.walk_m / NS)
    if not rates:
        return None
    names = ", ".join(f"{name} by {rate:+.2g} ppb" for name, rate in rates.items())
    told = scene.clocks.drift_prior_ppb
    if model.drifting and max(map(abs, rates.values())) <= told:
        return f"clocks are believed to drift, as clocks.drift_prior_ppb = {told:g} lets them: {names}"
    allowed = f"drift_prior_ppb is {told:g}" if told else "has no drift_prior_ppb"
    least = float(f"{2 * max(map(abs, rates.values())):.1g}")
    return (
        f"clocks drift, as far as they are followed: {names} (ns in a second) against the others, more than "
        f"walk_ns = {scene.clocks.walk_ns:g} explains; the scene's [clocks] {allowed}: set it to {least:g}"
    )


def _rates(track: ClockTrack, known: NDArray[np.bool_], walk_ns: float) -> dict[str, float]:
    """Rates (ns/s) of devices that drift, by name: the surest of all stretches of the run.

    Parameters
    ----------
    known : (D,) bool
        Whose clocks are; without any rates are against the median device's.
    walk_ns : float
        Of unknown clocks, in a root second.
    """
    count = len(track.step)
    length = max(LEAST_STEPS, (count - SETTLED) // PARTS)
    firsts = range(SETTLED, count - length + 1, max(length // 2, 1))
    stretches = [slice(SETTLED, count), *(slice(first, first + length) for first in firsts)]
    best: dict[int, tuple[float, float]] = {}
    for stretch in stretches:
        time, offset = track.time_s[stretch], 1e9 * track.offset_s[stretch]
        if len(time) < LEAST_STEPS:
            continue
        away = time - time.mean()
        rate = away @ offset / (away @ away)
        common = 0.0 if known.any() else float(np.median(rate))
        middle = 0.0 if known.any() else np.median(offset - offset[:1], axis=1, keepdims=True)
        course = offset - offset[:1] - middle
        unset = np.append(track.unset[stretch].any(0), np.zeros(len(track.device) - track.anchors, bool))
        spread = walk_ns * float(np.sqrt(1.2 / np.ptp(time)))
        for device in np.flatnonzero(~known & ~unset).tolist():
            own = float(rate[device]) - common
            sure = abs(own) / max(spread, 1e-12)
            line = np.corrcoef(away, course[:, device])[0, 1] ** 2 if np.ptp(course[:, device]) else 0.0
            if sure > SURE and line > STRAIGHT and sure > best.get(device, (0.0, 0.0))[0]:
                best[device] = sure, own
    return {track.device[device]: best[device][1] for device in sorted(best)}
