"""Figures of runs on sampled signals: signals against their model, errors of the images, rings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.special import gammaincinv

from gridslam.arrays import Array
from gridslam.drawing.map_figure import BLUE, GREEN, ORANGE, PAGE_IN, PURPLE, blank, scatterers
from gridslam.estimates import Estimate
from gridslam.evaluation.image_truth import image_gospa
from gridslam.inference.messages.signal_likelihood import Band
from gridslam.inference.state.images import DirectState
from gridslam.inference.state.rings import MOVING
from gridslam.measurements.recording import Recording
from gridslam.simulation.image_source import Truth
from gridslam.world.scene import Scene

BELIEVED = 0.5
"""Existence from which on a path is drawn."""
FLOOR_DB = -10.0


def draw_signal(
    recording: Recording, estimates: list[Estimate], step: int | None = None, truth: Truth | None = None,
    width: float = PAGE_IN,
) -> Figure:  # fmt: skip
    """Delay profile of every anchor at one step (default: the middle one), and what the model makes of it.

    Each panel: the matched filter's output over the noise; its mean by the paths believed in; these paths as
    stems, and true ones as ticks, where they are known. Elements of arrays are averaged: each gets its share
    of a path.
    """
    step = len(estimates) // 2 if step is None else step
    band = Band.of(recording.waveform.offset_hz, recording.waveform.pulse)
    own, names = estimates[step].paths, recording.anchors
    figure = blank(width, 0.6 + 1.9 * len(names))
    grid = np.linspace(0, band.folding_m, 1024)
    response = np.conj(band.response(grid))
    for anchor, axes in enumerate(np.atleast_1d(figure.subplots(len(names), 1, sharex=True))):
        samples = recording.samples[recording_row(recording, estimates[step]), anchor]
        elements = samples.shape[0] * samples.shape[1]
        power = (np.abs(samples.reshape(elements, -1) @ response.T) ** 2).mean(0)
        mine = (own.anchor == anchor) & (own.existence > BELIEVED)
        level = np.square(own.amplitude[mine]) / elements
        modelled = 1 + (np.abs(response @ band.response(own.distance_m[mine]).T) ** 2) @ level
        # amplitudes are in units of the noise, of which the profile's median tells
        middle = gammaincinv(elements, 0.5) / elements  # median of a mean of exponential powers
        noise = max(float(np.median(power / modelled)) / middle, 1e-300)
        axes.plot(grid, _db(power / noise), color=BLUE, lw=0.9, label="received")
        axes.plot(grid, _db(modelled), color=ORANGE, lw=1.6, ls="--", label="mean of the model")
        axes.vlines(
            own.distance_m[mine] % band.folding_m, FLOOR_DB, _db(1 + level), color=GREEN, lw=1.2,
            label="paths believed in",
        )  # fmt: skip
        if truth is not None:
            here = truth.paths.at(step)
            far = here.distance_m[here.anchor == anchor] % band.folding_m
            axes.plot(far, np.full(len(far), FLOOR_DB), "k|", ms=9, mew=1.4, label="true paths")
        axes.set(ylabel=f"{names[anchor]} (dB)", ylim=(FLOOR_DB, None), xlim=(0, band.folding_m))
        axes.grid(alpha=0.3)
    figure.axes[0].legend(loc="upper right", fontsize="small", frameon=False)
    figure.axes[-1].set_xlabel(f"distance (m), step {estimates[step].step}")
    return figure


def recording_row(recording: Recording, estimate: Estimate) -> int:
    """Row of the recording that an estimate is of."""
    return int(np.searchsorted(recording.time_s, estimate.time_s - 1e-9))


def draw_gospa(scene: Scene, estimates: list[Estimate], truth: Truth, width: float = PAGE_IN) -> Figure:
    """GOSPA (2 m, order 1) of the images of every anchor over time, as in [LiangDirect], Fig. 6."""
    figure = blank(width, 0.45 * width)
    axes = figure.subplots()
    error = image_gospa(scene, estimates, truth)
    for anchor, color in zip(range(len(error)), (BLUE, ORANGE, GREEN, PURPLE) * len(error), strict=False):
        axes.plot([e.step for e in estimates], error[anchor], color=color, label=scene.anchor_names[anchor])
    axes.set(xlabel="step", ylabel="GOSPA of images (m)", ylim=(0, None))
    axes.legend(ncols=4, fontsize="small", frameon=False)
    axes.grid(alpha=0.3)
    return figure


def draw_images(scene: Scene, state: DirectState, anchor: int = 0, width: float = PAGE_IN) -> Figure:
    """Images of one anchor in a state of direct SLAM: settled ones (three deviations), rings, true walls."""
    figure = blank(width, width)
    axes = figure.subplots()
    axes.set_aspect("equal")
    for piece in np.stack([scene.segments().start, scene.segments().end], 1):
        axes.plot(*piece.T, color="k", lw=1.2)
    scatterers(axes, scene, "k")
    rings = state.tentative.rings
    for row in np.flatnonzero(rings.anchor == anchor):
        image, weight = rings.mean[row, :, MOVING:], rings.weight[row]
        axes.scatter(
            image[:, 0],
            image[:, 1],
            s=4 + 60 * weight,
            color=PURPLE,
            alpha=float(0.2 + 0.8 * rings.existence[row]),
        )
    for row in np.flatnonzero(state.images.anchor == anchor):
        _ellipse(axes, state.places[row], state.place_covariances[row], BLUE)
    _ellipse(axes, state.belief.mean[:2], state.belief.covariance[:2, :2], GREEN)
    axes.plot(
        *scene.anchor_positions[anchor], "^", color=ORANGE, label=f"anchor {scene.anchor_names[anchor]}"
    )
    axes.plot(*state.belief.mean[:2], "o", color=GREEN, ms=4, label="agent")
    axes.plot([], [], "x", color=BLUE, label="settled images")
    axes.plot([], [], "o", color=PURPLE, label="hypotheses of rings")
    axes.legend(fontsize="small", frameon=False)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    return figure


def _ellipse(axes: Axes, place: Array, covariance: Array, color: str) -> None:
    value, vector = np.linalg.eigh(covariance)
    long, short = 6 * np.sqrt(np.maximum(value[::-1], 0))
    turn = float(np.degrees(np.arctan2(vector[1, 1], vector[0, 1])))
    axes.add_patch(Ellipse((place[0], place[1]), long, short, angle=turn, fill=False, color=color))
    axes.plot(*place, "x", color=color, ms=4)


def _db(power: Array) -> Array:
    return np.asarray(10 * np.log10(np.maximum(power, 1e-12)))
