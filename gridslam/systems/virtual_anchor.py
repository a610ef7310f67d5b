"""The reference of paper 002 (REFA, section VI): potential virtual anchors, independent for every anchor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from gridslam.inference.messages import ranging
from gridslam.inference.messages.exact_association import associate_exactly
from gridslam.inference.messages.likelihood_ratios import Evaluation
from gridslam.inference.state import rings
from gridslam.inference.state.anchor_measurements import Heard
from gridslam.maps.map import Map
from gridslam.systems.adaptive import AdaptiveSlam
from gridslam.world.geometry import unit
from gridslam.world.radio import REFLECTION_BINS
from gridslam.world.scene import Scene

Array = NDArray[np.float64]


class VirtualAnchorSlam(AdaptiveSlam):
    """SLAM by virtual anchors, one step at a time.

    A virtual anchor is the mirror image of one anchor, so it is kept as the line between the two: that line
    serves its own anchor alone, by single bounces. What an anchor teaches of a wall, the others have to
    learn again; double bounces, whose departure no single bounce explains, count as clutter.

    Of a radio that measures distances alone, the images start as rings about the agent, which shrink while it
    moves (`gridslam.inference.state.rings`); its heading can't be told then.

    Parameters
    ----------
    scene : Scene
        Radio, anchors and filter settings; its walls are never read.
    prior_map : Map, optional
        Not used: a virtual anchor is nothing that another agent's surfaces could stand for.
    agent : str, optional
        Which of the scene's agents (default: the first): start, prior and array.
    seed : int
    """

    shared = False

    def __init__(
        self, scene: Scene, prior_map: Map | None = None, agent: str | None = None, seed: int = 0
    ) -> None:
        super().__init__(scene, None, agent, seed)
        self.most_bounces = min(self.most_bounces, 1)
        self.rings = rings.Rings.empty()
        self._told, self._begun = np.zeros((0, 0)), (np.zeros(0), np.zeros((0, 0)))

    def _move(self, now: float) -> None:
        """Motion of the agent, which the rings follow."""
        if self.last_time is not None:
            self.rings = rings.move(self.rings, now - self.last_time, self.settings.acceleration_mps2)
        super()._move(now)

    def _take_in(self, heard: Heard) -> None:
        """Messages of one anchor: first those of its virtual anchors, then those of the rings."""
        with self._followed():
            super()._take_in(heard)
        # updates of rings by what the association left them; new rings
        worth = ranging.judge(self.rings, heard, self.detected, self.signal)
        self.rings = ranging.learn(self.rings, worth, self._told)
        chance, bearings = self._begun
        self.rings = ranging.begin(self.rings, self.belief, heard, self.signal, chance, bearings)

    def _associate(self, heard: Heard, said: Evaluation) -> tuple[Array, Array]:
        """Data association of virtual anchors and rings alike."""
        worth = ranging.judge(self.rings, heard, self.detected, self.signal)
        tentative, silent = ranging.claims(self.rings, worth)
        born, bearings = ranging.expected(
            self.belief, heard, self.signal, self.settings.births, self.middle, self.radius_m
        )
        nu, claimed = associate_exactly(
            np.concatenate([said.beta, tentative]), np.concatenate([said.missed, silent]), said.new + born
        )
        paths = len(said.beta)
        self._told = nu[paths:]
        self._begun = born / (said.new + born + claimed), bearings
        return nu[:paths], claimed

    def _tidy(self) -> None:
        """Rings that have shrunk to a place become virtual anchors; duplicates merge, the unlikely go."""
        for row in rings.shrunk(self.rings, self.places, self.signal)[::-1].tolist():
            self._join(row)
        with self._followed():
            super()._tidy()
        self.rings = rings.prune(self.rings, self.settings.survival)

    def _join(self, row: int) -> None:
        ring = self.rings.take(np.array([row]))
        anchor = int(ring.anchor[0])
        with self._followed():
            self.belief = rings.join(self.rings, row, self.belief, self.places[anchor])
            foot = float(self.belief.mean[:2] @ unit(self.belief.lines[-1, 0] + 0.5 * np.pi))
            bins = np.full(len(REFLECTION_BINS), 1 / len(REFLECTION_BINS))
            self.bank = self.bank.add(
                self.next_identity, float(ring.existence[0]), bins, foot, (anchor, -1, -1), anchor
            )
            self.bank.age[-1], self.bank.seen[-1] = ring.age[0], ring.seen[0]
            self.next_identity += 1
        self.rings = self.rings.take(np.arange(len(self.rings)) != row)

    @contextmanager
    def _followed(self) -> Iterator[None]:
        """Let the rings follow whatever the block does to the belief."""
        before = self.belief.copy()  # it is corrected in place
        yield
        self.rings = rings.follow(self.rings, before, self.belief)
