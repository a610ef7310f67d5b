"""Plain NumPy twins of the kernels: what the tests compare with and what the benchmark measures against.

Each takes what its kernel takes and returns what that writes, worked out another way.
"""

from gridslam.reference.births import initialise_surface, likely, propose, weigh_by_visibility
from gridslam.reference.cells import (
    cast,
    cells_of,
    coefficient_product,
    dense,
    fold_messages,
    learn,
    learn_ratios,
    mark,
)
from gridslam.reference.distances import climb_distances
from gridslam.reference.faint_births import bear_out
from gridslam.reference.feature_likelihood import (
    back_project,
    climb_features,
    columns,
    differentiate_features,
    evaluate_features,
)
from gridslam.reference.feature_paths import multiply_paths, place_paths, slope_paths
from gridslam.reference.gaussian import bend, bend_of_bounce, correct, late, of_length, predict, tall
from gridslam.reference.histograms import listen, walk
from gridslam.reference.line_evidence import weigh_lines
from gridslam.reference.merging import find_duplicates, find_ghosts
from gridslam.reference.messages import associate, enter, evaluate, gate, length_given, log_rician, weigh
from gridslam.reference.particle_densities import weigh_particles
from gridslam.reference.paths import densities, draw, lines_of, polylines, prepare, trace_paths
from gridslam.reference.rays import list_paths, near
from gridslam.reference.readout import describe
from gridslam.reference.rings import follow_rings, weigh_rings
from gridslam.reference.scatterers import fit_forms
from gridslam.reference.sight_filter import follow_sights
from gridslam.reference.superposition import climb, respond, superpose
from gridslam.reference.updates import effective_sample_size, exist, fit, update
from gridslam.world.geometry import trace

__all__ = [
    "associate",
    "back_project",
    "bear_out",
    "bend",
    "bend_of_bounce",
    "cast",
    "cells_of",
    "climb",
    "climb_distances",
    "climb_features",
    "coefficient_product",
    "columns",
    "correct",
    "dense",
    "densities",
    "describe",
    "differentiate_features",
    "draw",
    "effective_sample_size",
    "enter",
    "evaluate",
    "evaluate_features",
    "exist",
    "find_duplicates",
    "find_ghosts",
    "fit",
    "fit_forms",
    "fold_messages",
    "follow_rings",
    "follow_sights",
    "gate",
    "initialise_surface",
    "late",
    "learn",
    "learn_ratios",
    "length_given",
    "likely",
    "lines_of",
    "list_paths",
    "listen",
    "log_rician",
    "mark",
    "multiply_paths",
    "near",
    "of_length",
    "place_paths",
    "polylines",
    "predict",
    "prepare",
    "propose",
    "respond",
    "slope_paths",
    "superpose",
    "tall",
    "trace",
    "trace_paths",
    "update",
    "walk",
    "weigh",
    "weigh_by_visibility",
    "weigh_lines",
    "weigh_particles",
    "weigh_rings",
]
