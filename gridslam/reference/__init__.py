"""Plain NumPy twins of the kernels: what the tests compare with and what the benchmark measures against.

Each takes what its kernel takes and returns what that writes, worked out another way.
"""

from gridslam.reference.births import bear, glance, likely, propose
from gridslam.reference.cells import absorb, cast, cells_of, dense, learn, mark, recall
from gridslam.reference.gaussian import correct, predict
from gridslam.reference.histograms import listen, walk
from gridslam.reference.messages import associate, enter, evaluate, gate, log_rician, weigh
from gridslam.reference.paths import densities, draw, lines_of, polylines, prepare
from gridslam.reference.rays import foresee, near
from gridslam.reference.readout import describe
from gridslam.reference.tidying import duplicate, haunt
from gridslam.reference.updates import effective_sample_size, exist, fit, update
from gridslam.world.geometry import trace

__all__ = [
    "absorb", "associate", "bear", "cast", "cells_of", "correct", "dense", "densities", "describe", "draw",
    "duplicate", "effective_sample_size", "enter", "evaluate", "exist", "fit", "foresee", "gate", "glance",
    "haunt", "learn", "likely", "lines_of", "listen", "log_rician", "mark", "near", "polylines", "predict",
    "prepare", "propose", "recall", "trace", "update", "walk", "weigh",
]  # fmt: skip
