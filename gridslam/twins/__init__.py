"""Plain NumPy twins of the kernels: what the tests compare with and what the benchmark measures against.

Each takes what its kernel takes and returns what that writes, worked out another way.
"""

from gridslam.geometry import trace
from gridslam.twins.births import bear, glance, likely, propose
from gridslam.twins.cells import absorb, cast, cells_of, learn, mark, recall
from gridslam.twins.gaussian import correct, predict
from gridslam.twins.histograms import listen, walk
from gridslam.twins.messages import associate, enter, evaluate, gate, log_rician, weigh
from gridslam.twins.paths import densities, draw, lines_of, polylines, prepare
from gridslam.twins.rays import foresee, near
from gridslam.twins.readout import describe
from gridslam.twins.tidying import duplicate, haunt
from gridslam.twins.updates import effective_sample_size, exist, fit, update

__all__ = [
    "absorb", "associate", "bear", "cast", "cells_of", "correct", "densities", "describe", "draw",
    "duplicate", "effective_sample_size", "enter", "evaluate", "exist", "fit", "foresee", "gate", "glance",
    "haunt", "learn", "likely", "lines_of", "listen", "log_rician", "mark", "near", "polylines", "predict",
    "prepare", "propose", "recall", "trace", "update", "walk", "weigh",
]  # fmt: skip
