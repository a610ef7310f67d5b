"""The front door of systems on sampled signals."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

from gridslam.errors import InputError
from gridslam.maps.map import Map
from gridslam.systems.filter_front import FilterFront
from gridslam.world.filter_model import FilterModel
from gridslam.world.observation import Kind
from gridslam.world.scan import Scan
from gridslam.world.scene import Scene
from gridslam.world.signal_model import SignalModel
from gridslam.world.signal_scan import SignalScan
from gridslam.world.start import require_scene
from gridslam.world.waveform import Waveform

Believed = TypeVar("Believed")


class SignalFilter(FilterFront[SignalScan, Believed]):
    """A filter that is handed samples: `start` and `advance` get a `SignalModel`.

    Parameters
    ----------
    scene : Scene
        Anchors, region and filter settings; its walls are never read.
    prior_map : Map, optional
        Map that an earlier agent left.
    agent : str, optional
        Which of the scene's agents (default: the first): start and prior.
    seed : int
    same_frame : bool
        The user's word that `prior_map` is in the scene's frame, where it shares no anchor with it.
    waveform : Waveform, optional
        Of the recording, `Recording.waveform`. Default: what the scene's radio would sample.

    Raises
    ------
    InputError
        A scene without agents, an unknown one, a map of another frame, a waveform of other anchors, or none
        where the scene says no frequencies.
    """

    takes: ClassVar[Kind] = "signal"
    model: SignalModel

    def __init__(
        self,
        scene: Scene,
        prior_map: Map | None = None,
        agent: str | None = None,
        seed: int = 0,
        same_frame: bool = False,
        waveform: Waveform | None = None,
    ) -> None:
        require_scene(scene)
        scene.filter_model(agent)  # whoever isn't there is told first
        scene.require_planar()
        self.waveform = scene.waveform(agent) if waveform is None else waveform
        if len(self.waveform.anchor_element_m) != len(scene.anchors):
            found = f"{len(self.waveform.anchor_element_m)} anchors"
            raise InputError("signal: waveform", found, f"{len(scene.anchors)}, as in the scene")
        super().__init__(scene, prior_map, agent, seed, same_frame)

    def _model(self, model: FilterModel) -> Any:
        return SignalModel.of(model, self.waveform, self.scene.radio.fading == "swerling1")

    def _checked(self, scan: SignalScan, after: float | None) -> SignalScan:
        if not isinstance(scan, SignalScan):
            kind = "path measurements" if isinstance(scan, Scan) else type(scan).__name__
            raise InputError(f"{type(self).__name__}.step", kind, "sampled signals, a SignalScan")
        return scan.checked(len(self.model.anchors), after, self.waveform.shape)
