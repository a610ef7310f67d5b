"""What a filter may know of a scene. Walls, waypoints and tracks have no place in it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from gridslam.arrays import Array
from gridslam.world.filter_settings import FilterSettings
from gridslam.world.geometry import wrap
from gridslam.world.radio import RadioModel
from gridslam.world.scene_parts import GridSpec

FIXED = -2
"""Stands for the rise of an anchor whose height is known where others' aren't."""


@dataclass(frozen=True, eq=False)
class FilterModel:
    """Radio, anchors, region, priors and settings of one agent: all that inference is handed of a scene.

    `Scene.filter_model` makes one.

    Attributes
    ----------
    scene, agent : str
        Names.
    radio : RadioModel
        As the scene states it; what is learned of it stands in the state.
    anchor_names : tuple of str
        Of those that send.
    anchors : (J, 3) float64
        x, y (m) and orientation (rad), read-only. Where floor and ceiling reflect, the images of all anchors
        in them follow: J counts those, too.
    anchor_heights : (J,) float64
        How high they stand above the agent as told (m), read-only: 0 where all is planar.
    max_bounces : int
        Bounces of the paths that are listed.
    grid : GridSpec
        Region and cells.
    settings : FilterSettings
    start_mean, start_variance : (5,) float64
        Prior of x, y, vx, vy (m, m/s) and heading (rad).
    rise : (J,) int
        Which rise each anchor has, by which it is higher than told; -1 for none.
    rise_variance : (G, G) float64
        Prior covariance of the rises (m^2).
    higher : (G,) float64
        What the rises are believed to be (m).
    level_prior : (W, 50) float64 or None
        Prior beliefs about coefficients of floor and ceiling; see `levels.Verticals.coefficient`.
    level_names : tuple of str
        What the levels are: "floor", "ceiling".
    origin_m : (2,) float64
        Where the origin of all positions lies in the scene, m.
    mounting_std : (senders, 2) float64
        Deviations of the anchors' places (m, of x and y each) and orientations (rad), (M568), (M569).
    aside : (senders, 3) float64, optional
        How they are believed to stand otherwise, dx, dy (m) and turn (rad): `anchors` has that in.
    seed : int
        By which a start draws particles, where a method has any.
    """

    scene: str
    agent: str
    radio: RadioModel
    anchor_names: tuple[str, ...]
    anchors: Array
    anchor_heights: Array
    max_bounces: int
    grid: GridSpec
    settings: FilterSettings
    start_mean: Array
    start_variance: Array
    rise: NDArray[np.intp]
    rise_variance: Array
    higher: Array
    level_prior: Array | None = field(default=None, kw_only=True)
    level_names: tuple[str, ...] = field(default=(), kw_only=True)
    origin_m: Array = field(default_factory=lambda: fixed(np.zeros(2)), kw_only=True)
    mounting_std: Array = field(kw_only=True)
    aside: Array | None = field(default=None, kw_only=True)
    seed: int = field(default=0, kw_only=True)

    @property
    def senders(self) -> int:
        """How many anchors send: they come first, the others are images in floor and ceiling."""
        return len(self.anchor_names)

    @cached_property
    def anchor_positions(self) -> Array:
        """Where the anchors stand, (J, 2) m."""
        return fixed(np.ascontiguousarray(self.anchors[:, :2]))

    @property
    def anchor_orientations(self) -> Array:
        """Where the anchors' arrays point, (J,) rad."""
        return self.anchors[:, 2]

    @cached_property
    def places(self) -> Array:
        """The anchors as kernels take them, (J, 6): x, y (m), orientation (rad), height as believed and as
        told (m), and number of its rise; -1 for none, `FIXED` where others have one."""
        stated, rise = self.anchor_heights, np.full(len(self.anchors), -1.0)
        believed = stated
        if len(self.higher):
            believed = stated + np.where(self.rise >= 0, self.higher[self.rise], 0.0)
            rise = np.where(self.rise >= 0, self.rise, FIXED).astype(np.float64)
        return fixed(np.column_stack([self.anchors, believed, stated, rise]))

    @property
    def orientation_std(self) -> Array:
        """Deviations of the anchors' orientations, (senders,) rad."""
        return self.mounting_std[:, 1]

    @property
    def unsure(self) -> NDArray[np.bool_]:
        """Of which anchors it isn't known how they stand, (senders,)."""
        return np.asarray((self.mounting_std > 0).any(1))

    @property
    def place_stds(self) -> tuple[float, ...]:
        """Deviations of the anchors' places, (senders,) m; none if all are known."""
        own = self.mounting_std[:, 0]
        return tuple(own.tolist()) if own.any() else ()

    @property
    def mounting_variance(self) -> float:
        """Variance of how the only anchor is mounted (rad^2): all may turn about it by as much, (M568).

        0 where there are several: what one is turned by is no turn of all.
        """
        return float(self.orientation_std[0]) ** 2 if self.senders == 1 else 0.0

    @cached_property
    def middle(self) -> Array:
        """Middle of the region, (2,) m."""
        side = np.array(self.grid.shape[::-1]) * self.grid.cell_m
        return np.asarray(self.grid.origin_m + 0.5 * side, np.float64)

    @cached_property
    def radius_m(self) -> float:
        """Radius of the circle about the region, m."""
        return float(0.5 * np.hypot(*(np.array(self.grid.shape[::-1]) * self.grid.cell_m)))

    @cached_property
    def birth_rate(self) -> float:
        """Half the density of births over the lines that cross the circle about the region, per (rad m).

        Per anchor and step, ``births / (4 pi R)``: lines have the density ``1 / (2 pi R)``, and the half is
        that of the Jacobian ``z / 2 Delta`` from a line to distance and AoA; docs/model.md, (M32).
        """
        return self.settings.births / (4 * np.pi * self.radius_m)

    def calibrated(self, turns: Array, higher: Array, aside: Array | None = None) -> Self:
        """The model with its anchors turned by (senders,) rad, their images with them, and rises of (G,) m.

        The same object where that changes nothing.

        Parameters
        ----------
        aside : (senders, 3), optional
            How anchors stand otherwise than is told beside, see the attribute.
        """
        turned = np.column_stack([np.zeros((len(turns), 2)), turns])
        so_far = 0.0 if self.aside is None else self.aside
        moved = np.resize(turned if aside is None else turned + aside - so_far, self.anchors.shape)
        if not moved.any() and np.array_equal(higher, self.higher):
            return self
        anchors = self.anchors + moved
        anchors[:, 2] = wrap(anchors[:, 2])
        model = replace(self, anchors=fixed(anchors), higher=fixed(higher.copy()))
        return model if aside is None else replace(model, aside=fixed(aside.copy()))


def detected(existence: Array, settings: FilterSettings) -> NDArray[np.bool_]:
    """Which surfaces, images or rays are declared to exist: [Li2026grid], section III-F.

    Parameters
    ----------
    existence : (S,)
        Probability of each.
    settings : FilterSettings
        Above whose `detect_above` they are.
    """
    return existence > settings.detect_above


def fixed(array: Array) -> Array:
    """The array, read-only from now on."""
    array.setflags(write=False)
    return array
