"""What a filter on sampled signals may know of a scene and of a recording."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

from gridslam.world.filter_model import FilterModel
from gridslam.world.waveform import Waveform


@dataclass(frozen=True, eq=False)
class SignalModel(FilterModel):
    """`FilterModel`, with what must be known of the samples.

    Attributes
    ----------
    waveform : Waveform
        Frequencies, pulse and elements. Its anchors are those of the model, in their order.
    fades : bool
        Whether amplitudes are drawn anew at each step (Swerling 1); else they are steady.
    """

    waveform: Waveform
    fades: bool = False

    @classmethod
    def of(cls, model: FilterModel, waveform: Waveform, fades: bool = False) -> Self:
        """A filter's model and a recording's waveform, as one."""
        known = {f.name: getattr(model, f.name) for f in fields(FilterModel)}
        return cls(**known, waveform=waveform, fades=fades)
