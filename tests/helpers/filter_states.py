"""Models, states and grids for tests, put together without a scene file of their own."""

from dataclasses import replace

import numpy as np

import gridslam as gs
from gridslam.inference.beliefs.belief import Belief
from gridslam.inference.beliefs.particles import Cloud, Sampling
from gridslam.inference.messages.cells import cast_at, casting_of, update_cells
from gridslam.inference.scans.anchor_measurements import anchor_scans
from gridslam.inference.state.grid import Grid
from gridslam.inference.state.rays import Rays
from gridslam.inference.state.state import State
from gridslam.inference.state.surface_bank import BINS, SurfaceBank
from gridslam.inference.workspace.workspace import Workspace
from gridslam.world.scene_parts import GridSpec


def model_of(scene="room", anchors=None, radio=None, **settings):
    """What a filter may know of a bundled scene, with other anchors (J, 3 or more), radio or settings."""
    model = gs.Scene.load(scene).filter_model()
    model = replace(model, settings=model.settings.model_copy(update=settings))
    if anchors is not None:
        whole = np.zeros((len(anchors), 4))
        some = np.asarray(anchors)[:, :4]
        whole[:, : some.shape[1]] = some
        model = replace(
            model,
            anchors=whole[:, :3],
            anchor_heights=whole[:, 3],
            anchor_names=tuple(map(str, range(len(anchors)))),
            mounting_std=np.zeros((len(anchors), 2)),
        )
    return model if radio is None else replace(model, radio=radio)


def state_of(belief, anchors=1, existence=0.5):
    """A state that believes this, of surfaces that nothing else is known of."""
    bank = SurfaceBank.empty(anchors)
    for number in range(len(belief.lines)):
        bank = bank.add(number, existence, np.full(BINS, 1 / BINS), 0.0, (0, -1, -1))
    return replace(State.start(model_of(anchors=np.zeros((anchors, 3)))), belief=belief, surfaces=bank)


def state_of_departures(missed, std, beside=None):
    """A state with one wall, y = 3, which mirrors an anchor at the origin to (0, 6), and departures off it.

    Of deviation `std`, they missed a mirror's by `missed` and a right corner's by `beside` (all (K,) rad;
    otherwise by so much to either side in turn that no corner sends them).
    """
    missed, std = np.asarray(missed, float), np.asarray(std, float)
    beside = np.resize([-1.5, 1.5], len(missed)) if beside is None else np.asarray(beside)
    wall = np.array([4.0, 0, 0, 0, 0, 0.5 * np.pi, 3.0])
    state = state_of(Belief(wall, 1e-6 * np.eye(7)), 1, existence=0.9)
    weight = std**-2.0
    costs = [0.5 * np.minimum((angle / std) ** 2, 2.5**2).sum() for angle in (missed, beside)]
    turned = [(weight * side(beside)).sum() for side in (np.cos, np.sin)]
    told = [weight.sum(), (weight * missed).sum(), 0, 0, *costs, *turned]
    return replace(state, surfaces=replace(state.surfaces, angles=np.array([[told]])))


def anchor_scans_of(case, step):
    """Measurements of a disturbed case at a step, split by the anchors that its filter believes in."""
    scan, world = case.measurements.scan(step), case.believed
    threshold = world.signal_model(case.agent).threshold
    return anchor_scans(scan, world.filter_model(case.agent).places, threshold)


class Plot:
    """A grid alone, whose cells are told of paths by messages."""

    def __init__(self, shape, free_path=10.0, side=1.0, anchors=((100.0, 100.0),), origin=(0.0, 0.0)):
        (rows, columns), (x, y) = shape, origin
        region = GridSpec(x_m=(x, x + columns * side), y_m=(y, y + rows * side), cell_m=side)
        anchors = np.pad(np.asarray(anchors, float), ((0, 0), (0, 1)))
        self.model = replace(model_of(anchors=anchors, mean_free_path_m=free_path), grid=region)
        self.work = Workspace(self.model, 1, grid=True)
        self.state = replace(State.start(self.model), grid=Grid.empty(shape))

    @property
    def grid(self):
        return self.state.grid

    @property
    def cells(self):
        return self.work.require_cells()

    def believe(self, evidence):
        """Have other evidence."""
        self.state = replace(self.state, grid=replace(self.grid, evidence=np.array(evidence, float)))

    def tell(self, rays, samples, anchors, worth):
        """Cast paths that are worth so much at sampled states, add their messages, return V of each."""
        messages = self.work.messages
        messages.clear()
        messages.reserve(len(rays), 0, (1 + int(rays.last.max()), 1))
        messages.count[0], rows = len(rays), slice(0, len(rays))
        messages.path[rows], messages.factor[rows, 0], messages.factor[rows, 1] = rays.table, worth, True
        cast = casting_of(len(messages.path), samples.draft.state.shape[1], 0)
        cast_at(samples, self.grid, cast, np.asarray(anchors, float), self.work)
        return cast.seen[rows, 0]

    def fold_messages(self):
        """Fold the messages in."""
        self.state = update_cells(self.state, work=self.work)


def sighting(plot, worth=9.0):
    """Tell 4 x 4 cells of a line of sight along their diagonal."""
    one, none = np.ones(1), np.full(1, -1)
    ray = Rays.of(np.zeros(1, int), np.zeros(1, int), none, none, one, one)
    samples = Sampling.at(Cloud(np.array([[3.5, 3.5, 0.0]]).T, 0.0))
    plot.tell(ray, samples, [[0.5, 0.5, 0.0]], worth)


def small():
    """4 x 4 cells and an anchor."""
    return Plot((4, 4), 5.0, anchors=[[0.5, 0.5]])
