"""Whether directions in sampled signals are where known places have them, and how elements are meant if not.

At the delay of the line of sight a matched array has the power of all its elements; of all readings of the
elements' places and of the headings the right one does. How much that is depends on the noise, of which
delays without a path tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from gridslam.arrays import Array, squared
from gridslam.checks.signals.places import Complex, Places
from gridslam.world.geometry import wrap
from gridslam.world.waveform import Waveform, steering

BETTER, TIMES = 0.25, 1.3
"""How much more than the file as it stands a reading must explain: of what noise leaves, and times."""
ENOUGH, DOUBTED, MISSED = 0.5, 0.7, 0.35
"""Share of what noise leaves that a reading must explain to be named, below which others are looked for among
the anchors, and below which directions are wrong."""
FEW, TIMES_OF_FEW = 20, 2.5
"""Snapshots below which chance may turn directions: more must be explained, and nothing is merely wrong."""
TOLD = 0.15
"""Share that noise must leave for anything to be told."""
WRAPPED_RAD, ALONG, MORE = 0.1, 0.5, 0.1
"""How far headings are from the true ones, in degrees and wrapped, up to which they are these; with errors of
a degree, mean cosine from which on they are, if so far above that of headings turned by any angle."""
COMPASS = (
    "heading_rad: clockwise from north (a compass's), where counter-clockwise from x belongs (pi/2 - heading)"
)
AS_WELL = 0.1
"""Share of what noise leaves by which another reading of headings may explain more than a compass's."""
MIRRORED, ACROSS = np.array([1.0, -1.0]), np.array([-1.0, -1.0])


class Elements(NamedTuple):
    """Places of elements, as they stand or as they may be meant.

    Attributes
    ----------
    anchor : (J, A, 2) m
    carried : (B, 2) m
    """

    anchor: Array
    carried: Array


class Directions(NamedTuple):
    """How well directions fit.

    Attributes
    ----------
    share : float
        Of the line of sight's power that comes from where it should.
    left : float
        What noise leaves of it where all is right.
    """

    share: float
    left: float

    @property
    def doubtful(self) -> bool:
        """Whether less comes from there than where all is right."""
        return self.share < DOUBTED * self.left

    @property
    def misses(self) -> bool:
        """Whether far less comes from there than noise explains."""
        return self.left > TOLD and self.share < MISSED * self.left


def noise_share(samples: Complex, matched: Complex, waveform: Waveform) -> float:
    """What noise leaves of the line of sight's power in the one direction of a matched array.

    Parameters
    ----------
    samples : (N, A, B, M) complex
    matched : (N, A, B) complex
        At the delay of the line of sight.
    """
    points, elements = samples.shape[-1], matched.shape[1] * matched.shape[2]
    response = np.fft.ifft(samples * waveform.pulse.conj(), axis=-1) * points
    # at most delays there is no path, and the noise's power is exponential: a quarter is below ln(4/3)
    noise = float(np.quantile(squared(response), 0.25, axis=-1).mean() / np.log(4 / 3))
    signal = max(1 - noise / max(float(squared(matched).mean()), 1e-300), 0.0)
    return signal + (1 - signal) / elements


def share_of(
    matched: Complex, elements: Elements, heading: Array, places: Places, waveform: Waveform
) -> float:
    """Mean share of the power at the line of sight that its directions explain.

    Parameters
    ----------
    matched : (N, A, B) complex
        At the delay of the line of sight.
    heading : (N,) rad
    """
    length, total = waveform.wavelength_m, 0.0
    for row, y in enumerate(matched):
        leaving = steering(elements.anchor[places.anchor[row]], places.aod_rad[row], length)
        arriving = steering(elements.carried, places.bearing_rad[row] - heading[row], length)
        total += abs(leaving.conj() @ y @ arriving.conj()) ** 2 / max(squared(y).sum(), 1e-300)
    return total / len(matched)


def readings(elements: Elements, waveform: Waveform) -> Iterator[tuple[str, Elements]]:
    """Other ways in which places of elements could have been meant: at both ends, or at one of them."""
    ways: Sequence[tuple[str, float | Array]] = (
        ("wavelengths, not metres", waveform.wavelength_m),
        ("millimetres, not metres", 1e-3),
        ("the opposite sign (of x and y, or phases of exp(-j))", ACROSS),
        ("y to the right, where it belongs to the left", MIRRORED),
        ("half as far apart as they are", 2.0),
        ("twice as far apart as they are", 0.5),
    )
    ends = [shape > 1 for shape in (elements.anchor.shape[1], elements.carried.shape[0])]
    for text, factor in ways:
        if all(ends):
            yield f"element_m: {text}", Elements(factor * elements.anchor, factor * elements.carried)
        if ends[0]:
            where = " of the anchors" if all(ends) else ""
            yield f"element_m{where}: {text}", elements._replace(anchor=factor * elements.anchor)
        if ends[1]:
            where = " of the agent" if all(ends) else ""
            yield f"element_m{where}: {text}", elements._replace(carried=factor * elements.carried)


def directions(
    raw: dict[str, Any], own: Complex, waveform: Waveform, places: Places, half: float
) -> tuple[Directions | None, list[str]]:
    """How well directions fit as they stand, and what would make them fit; None where nothing tells them."""
    shape = own.shape[1:3]
    arrays = [raw.get("anchor_element_m"), raw.get("agent_element_m")]
    if shape == (1, 1) or any(q is None and n > 1 for q, n in zip(arrays, shape, strict=True)):
        return None, []
    anchor = np.zeros((len(raw["anchors"]), 1, 2)) if arrays[0] is None else np.asarray(arrays[0])
    elements = Elements(anchor, np.zeros((1, 2)) if arrays[1] is None else np.asarray(arrays[1]))
    matched = _matched(own, waveform, places.distance_m, half)
    heading, others = places.heading_rad, dict[str, Array]()
    measured = raw.get("heading_rad") if shape[1] > 1 else None
    if measured is not None:
        heading = np.asarray(measured)[places.step]
        others = {"heading_rad: degrees, not radians": np.radians(heading)}
        others |= {"heading_rad: the opposite sign": -heading, COMPASS: 0.5 * np.pi - heading}
    left = noise_share(own, matched, waveform)
    plain = share_of(matched, elements, heading, places, waveform)
    fit = Directions(plain, left)
    lines = [
        f"directions: {plain:.0%} of the line of sight's power comes from where it should; with this noise "
        f"about {left:.0%} would if nothing overlapped it"
    ]
    ways = {text: share_of(matched, elements, one, places, waveform) for text, one in others.items()}
    for text, one in readings(elements, waveform):
        ways[text] = share_of(matched, one, heading, places, waveform)
    best = max(ways, key=lambda text: ways[text])
    if best in others and ways.get(COMPASS, 0.0) > ways[best] - AS_WELL * left:
        best = COMPASS  # degrees fit as well only of an agent that kept to one heading, of about 1.5 degrees
    known = None if measured is None else share_of(matched, elements, places.heading_rad, places, waveform)
    few = len(own) < FEW
    times = TIMES_OF_FEW if few else TIMES
    needed = max(ENOUGH * left, times * plain, plain + BETTER * left, TOLD)
    if ways[best] > needed and (known is None or ways[best] > known - 0.4 * BETTER * left):
        return fit, [*lines, f"suspect: {best}"]
    if known is not None and known > needed:
        what = "another frame or sensor than the agent's: the true heading fits"
        if _wrapped_degrees(heading, places.heading_rad):
            what = "degrees, not radians, wrapped since: the true heading fits, and in degrees it is this one"
        return fit, [*lines, f"suspect: heading_rad: {what}"]
    if fit.misses and not few:
        what = "element places, headings or orientations of anchors are other than they are said to be"
        lines.append(f"suspect: directions: {what}, or walls hide the anchors; no single cure explains them")
    return fit, lines


def _wrapped_degrees(heading: Array, true: Array) -> bool:
    """Whether headings (N,) are the true ones in degrees, kept wrapped, so that the turns are gone."""
    apart = wrap(heading - np.degrees(true))
    along, turned = np.cos(apart).mean(), np.abs(np.exp(1j * (heading - true)).mean())
    return bool(np.median(np.abs(apart)) < WRAPPED_RAD or along > max(ALONG, turned + MORE))


def _matched(own: Complex, waveform: Waveform, lengths: Array, half: float) -> Complex:
    """Samples (N, A, B) at the delay of the strongest peak within `half` of lengths (N,)."""
    tries = lengths[:, None] + np.linspace(-half, half, 41)
    response = waveform.delay_response(tries)
    found = np.einsum("ntm,nabm->ntab", response.conj(), own, optimize=True)
    best = (np.abs(found) ** 2).sum((2, 3)).argmax(1)
    return np.asarray(found[np.arange(len(own)), best])
