"""Frequencies in another unit, told by delays: lines of sight can't be a thousand times too long."""

from __future__ import annotations

from dataclasses import replace

from gridslam.arrays import Array
from gridslam.checks.signals.delays import Delays
from gridslam.checks.signals.places import Places
from gridslam.checks.signals.stated import FREQUENCY_UNITS, NEARLY
from gridslam.world.radio import SPEED_OF_LIGHT
from gridslam.world.scene import Scene
from gridslam.world.waveform import Waveform

SEEN, BETTER = 0.6, 0.25
"""Share of the strongest peak that must be at the line of sight in the other unit; how much more than as it
stands."""
NARROW = 10.0
"""How many times wider than what is looked at around a length, the folding range must be."""
READABLE = (1e4, 1e9)
"""Frequency steps (Hz) that a radio may have."""


def possible_units(waveform: Waveform) -> dict[float, str]:
    """Units in which frequencies are steps of a radio and within the carrier, by what makes Hz of them."""
    most = max(abs(float(waveform.offset_hz[0])), abs(float(waveform.offset_hz[-1])))
    return {
        factor: unit
        for factor, unit in FREQUENCY_UNITS.items()
        if READABLE[0] <= factor * waveform.step_hz <= READABLE[1] and factor * most < waveform.carrier_hz
    }


def factor_by_delays(
    samples: Array, waveform: Waveform, places: Places | None, scene: Scene | None
) -> tuple[float, str]:
    """What frequencies must be multiplied by for lines of sight to be as long as they are, and a line on it.

    Told only where the strongest paths are at the line of sight's length then, for most part, and not as it
    stands. A radio that is really so narrow has its strongest paths near its first delay, whatever the unit.

    Parameters
    ----------
    samples : (K, J, A, B, M) complex
        Of all steps and anchors.
    waveform : Waveform
        As it stands in the file.
    places : Places or None
        Where the line of sight is known; without any nothing is told.
    scene : Scene or None
        One that tells the frequencies' spacing, and another one than the file, is believed.

    Returns
    -------
    factor : float
        1 if no unit does that.
    line : str
        Empty then.
    """
    step = None if scene is None else scene.radio.frequency_step_hz
    if places is None or (step is not None and abs(step - waveform.step_hz) > NEARLY * step):
        return 1.0, ""
    plain = Delays.of(samples, waveform, places).share(places, half_width(waveform, places))
    best, factor, line = plain + BETTER, 1.0, ""
    for other, unit in possible_units(waveform).items():
        read = replace(waveform, offset_hz=other * waveform.offset_hz)
        half = half_width(read, places)
        if read.folding_m < max(NARROW * half, float(places.distance_m.max())):
            continue  # any peak would be near any length
        share = Delays.of(samples, read, places).share(places, half)
        if share > max(SEEN, best):
            best, factor = share, other
            line = (
                f"suspect: frequency_hz: probably {unit}, where Hz belong (times {other:g}): so read, "
                f"{share:.0%} of the strongest peak is found at the line of sight's length, {plain:.0%} as "
                f"it stands (steps of {waveform.step_hz:g} Hz); read as {unit} from here on"
            )
    return factor, line


def half_width(waveform: Waveform, places: Places) -> float:
    """How far beside its length the line of sight is looked for, m."""
    return max(0.75 * SPEED_OF_LIGHT / waveform.bandwidth_hz, places.slack_m)
