"""Settings of the filter, a part of a scene file."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gridslam.world.scene_parts import NotNegative, Positive, Probability, Share
from gridslam.world.validation import Strict


class FilterSettings(Strict, table="[filter]"):
    """Settings of the filter; the papers' values are the defaults."""

    particles: int = Field(10_000, ge=1)
    acceleration_mps2: Positive = 0.03
    heading_deg: Positive = 7.0
    surface_m: NotNegative = 0.005
    reflection: NotNegative = 0.01
    survival: Share = 0.999
    births: Positive = 0.1
    prune_below: Probability = 0.1
    detect_above: Probability = 0.5
    mean_free_path_m: Positive = 10.0
    adapt_particles: bool = False  # true: as few as the spread of the agent's pose asks for
    correlated: bool = True  # false: separate beliefs of agent and surfaces, as published
    representation: Literal["gaussian", "particles"] = "gaussian"  # "particles": as published
