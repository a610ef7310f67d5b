"""Figures of runs on sampled signals: signals against their model, errors of the images, rings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.special import gammaincinv

from gridslam.arrays import Array
from gridslam.drawing.map_figure import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    blank,
    ellipse,
    frame,
    true_walls,
)
from gridslam.drawing.widths import PAGE_IN
from gridslam.estimates import Estimate
from gridslam.evaluation.image_truth import image_gospa
from gridslam.inference.messages.samples.signal_likelihood import Band
from gridslam.measurements.recording import Recording
from gridslam.simulation.image_source import Truth
from gridslam.world.geometry import mirror, mirror_derivative
from gridslam.world.scene import Scene

BELIEVED = 0.5
"""Existence from which on a path is drawn."""
FLOOR_DB = -10.0


def typical_step(estimates: Sequence[Estimate]) -> int:
    """The step nearest to the middle at which some path is believed in; the middle one if none ever is."""
    middle = len(estimates) // 2
    telling = [step for step, own in enumerate(estimates) if (own.paths.existence > BELIEVED).any()]
    return min(telling, key=lambda step: abs(step - middle), default=middle)


def draw_signal(
    recording: Recording, estimates: list[Estimate], step: int | None = None, truth: Truth | None = None,
    width: float = PAGE_IN,
) -> Figure:  # fmt: skip
    """Delay profile of every anchor at one step (default: `typical_step`), and what the model makes of it.

    Each panel: the matched filter's output over the noise; its mean by the paths believed in; these paths as
    stems, and true ones as ticks, where they are known. Elements of arrays are averaged: each gets its share
    of a path.
    """
    step = typical_step(estimates) if step is None else step
    band = Band.of(recording.waveform.offset_hz, recording.waveform.pulse)
    own, names = estimates[step].paths, recording.anchors
    figure = blank(width, 0.85 + 1.9 * len(names))
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
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize="small", frameon=False)
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


def has_images(estimates: Sequence[Estimate]) -> bool:
    """Whether a method believed in images of anchors: surfaces that serve one anchor alone, or rings."""
    return any(len(e.rings) > 0 or bool((e.surfaces.owner >= 0).any()) for e in estimates)


def draw_images(scene: Scene, estimates: Sequence[Estimate], width: float = PAGE_IN) -> Figure:
    """Images of every anchor (a row each) over the floor plan, at the step with most rings and at the last.

    Detected images with three deviations; the places of rings believed in, the larger the likelier; true
    walls and the virtual anchors at them.
    """
    rings = [e.rings.take(e.rings.existence > BELIEVED) for e in estimates]
    most = int(np.argmax([len(np.unique(own.ring)) for own in rings]))
    moments = sorted({most, len(estimates) - 1})
    walls, anchors = scene.segments(), scene.anchor_positions
    _, first = np.unique(walls.surface, return_index=True)
    virtual = mirror(walls.line[first][None], anchors[:, None])  # (J, W, 2)
    places = [_places(scene, estimates[moment]) for moment in moments]
    agent = [estimates[moment].position_m[None] for moment in moments]
    shown = np.concatenate(
        [walls.start, walls.end, anchors, virtual.reshape(-1, 2), *agent, *(mean for _, mean, _ in places)]
    )
    margin = 0.06 * float(np.ptp(shown, axis=0).max())
    window = np.stack([shown.min(0) - margin, shown.max(0) + margin])
    across, up = window[1] - window[0]
    size = (width - 0.8) / len(moments) * float(np.clip(up / across, 0.3, 1.3))
    figure = blank(width, 0.7 + len(anchors) * (size + 0.3))
    panels = figure.subplots(len(anchors), len(moments), sharex=True, sharey=True, squeeze=False)
    for anchor, row in enumerate(panels):
        for axes, moment, (serves, place, spread) in zip(row, moments, places, strict=True):
            own, ring = estimates[moment], rings[moment].take(rings[moment].anchor == anchor)
            true_walls(axes, scene, "k", 1.0)
            hollow: dict[str, Any] = {"color": "0.35", "mfc": "none", "ms": 9}
            axes.plot(*virtual[anchor].T, "s", **hollow, label="true virtual anchors")
            axes.scatter(*ring.position_m.T, s=4 + 40 * ring.weight, color=PURPLE, label="places of rings")
            mine = serves == anchor
            axes.plot(*place[mine].T, "x", color=BLUE, ms=5, label="images found")
            for middle, covariance in zip(place[mine], spread[mine], strict=True):
                ellipse(axes, middle, covariance, BLUE)
            axes.plot(*own.position_m, "o", color=GREEN, ms=5, label="agent")
            axes.plot(*anchors[anchor], "^", color=ORANGE, ms=7, label="anchor")
            frame(axes, window)
            axes.label_outer()
            axes.set_title(f"anchor {scene.anchor_names[anchor]} at step {own.step}", fontsize="small")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="small", frameon=False)
    return figure


def _places(scene: Scene, estimate: Estimate) -> tuple[Array, Array, Array]:
    """Anchors (I,), places (I, 2) and covariances (I, 2, 2) of the images that an estimate has found."""
    found = estimate.surfaces.take(estimate.detected & (estimate.surfaces.owner >= 0))
    anchor = scene.anchor_positions[found.owner]
    slope = mirror_derivative(found.line, anchor)
    return found.owner, mirror(found.line, anchor), slope @ found.line_cov @ np.swapaxes(slope, 1, 2)


def _db(power: Array) -> Array:
    return np.asarray(10 * np.log10(np.maximum(power, 1e-12)))
