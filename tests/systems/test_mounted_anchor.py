"""An anchor that hangs on a wall makes no hole in it."""

import numpy as np
import pytest
from filter_states import Plot

import gridslam as gs
from gridslam.maps.nav2 import FREE, trinary


@pytest.mark.parametrize(("side", "gap"), [(0.1, 0.05), (0.05, 0.03), (0.2, 0.11)])
def test_no_cell_behind_the_wall_that_an_anchor_hangs_on_is_held_free(side, gap):
    plot = Plot((40, 40), side=side, anchors=[(20.3 * side, 30 * side - gap)])  # the wall: y = 30 cells
    clear = plot.cells.clear.reshape(40, 40)
    assert clear[29, 20]  # its own cell
    assert not clear[30:].any()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_nothing_is_free_behind_the_wall_that_an_anchor_hangs_on(seed):
    """Ghosts behind it were heard through the hole, and where their paths went became free."""
    data = gs.Scene.load("room").model_dump(exclude_none=True)
    mounted = {**data["anchors"][0], "position_m": (-1.0, 2.95), "orientation_deg": -90.0}
    agent = {**data["agents"][0], "steps": 60}
    parts = {
        "anchors": [mounted, data["anchors"][1]],
        "agents": [agent],
        "radio": {**data["radio"], "snr_at_1m_db": 38.0},
    }
    scene = gs.Scene.checked({**data, **parts}, "mounted")
    done = gs.map_scene(scene, gs.simulate(scene, "agent1", seed), seed=seed, particles=1000).map
    row, column = np.indices(done.shape)
    x, y = done.origin_m[0] + done.cell_m * (column + 0.5), done.origin_m[1] + done.cell_m * (row + 0.5)
    outside = (np.abs(x) > 4.2) | (np.abs(y) > 3.2)
    assert len(done.wall_segments()) >= 4
    assert not (outside & (trinary(done, done.wall_segments()) == FREE)).any()
    assert (outside & (done.evidence < -0.7)).sum() <= 5
