"""The reference of paper 002 (REFA, section VI): potential virtual anchors, independent for every anchor."""

from __future__ import annotations

from gridslam.map import Map
from gridslam.scene import Scene
from gridslam.systems.adaptive import AdaptiveSlam


class VirtualAnchorSlam(AdaptiveSlam):
    """SLAM by virtual anchors, one step at a time.

    A virtual anchor is the mirror image of one anchor, so it is kept as the line between the two: that line
    serves its own anchor alone, by single bounces. What an anchor teaches of a wall, the others have to
    learn again; double bounces, whose departure no single bounce explains, count as clutter.

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
