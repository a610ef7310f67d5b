"""Methods that stand for others, where what is heard or a scene's clocks ask for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gridslam.systems.registry import METHODS
from gridslam.world.network_scene import clocks_are_known

if TYPE_CHECKING:
    from gridslam.world.scene import Scene
    from gridslam.world.waveform import Waveform


def suited(method: str | type, waveform: Waveform | None) -> str | type:
    """The method that stands for another one on these signals: `direct` is `direct_grid` on arrays."""
    arrays = waveform is not None and max(waveform.shape[1:3]) > 1
    return "direct_grid" if method == "direct" and arrays else method


def clocked(method: str | type, scene: Scene, agents: Sequence[str]) -> str | type:
    """The method that stands for another one where clocks aren't known: `Method.clocked`."""
    if method not in METHODS or clocks_are_known(scene, agents):
        return method
    return METHODS[method].clocked or method
