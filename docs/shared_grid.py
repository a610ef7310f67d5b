"""Draw what each agent of scene `annex` says of the cells at one step, and what both say together.

``python docs/shared_grid.py [STEP]`` writes docs/shared-grid.png.
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import gridslam as gs
from gridslam.simulation.network import simulate_network
from gridslam.systems.network_grid import NetworkGridSlam, step

STEP, SHOWN = 130, 0.4


def main() -> None:
    """Run the scene up to the step, take it three times from there, and draw the changes of the cells."""
    last = int(sys.argv[1]) if len(sys.argv) > 1 else STEP
    scene = gs.Scene.load("annex")
    walls, names = scene.segments(), [agent.name for agent in scene.agents]
    heard, truth = simulate_network(scene, names, 1, unlabelled=True)
    slam = NetworkGridSlam(scene, agents=names, seed=1)
    for number in range(last):
        slam.step(heard.scan(number))
    before, scan = slam.state, heard.scan(last)
    asked = {
        f"{names[0]} alone": replace(scan, scans=(scan.scans[0], None)),
        f"{names[1]} alone": replace(scan, scans=(None, scan.scans[1])),
        "both, folded once": scan,
    }
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), sharey=True, layout="constrained")
    for axis, (title, own) in zip(axes, asked.items(), strict=True):
        after, _ = step(before, own, slam.model, slam.work)
        change = after.grid.evidence - before.grid.evidence
        extent = (*scene.grid.x_m, *scene.grid.y_m)
        shown = axis.imshow(change, origin="lower", extent=extent, cmap="RdBu_r", vmin=-SHOWN, vmax=SHOWN)
        axis.plot(*np.transpose([walls.start, walls.end], (2, 0, 1)), color="k", lw=0.8)
        axis.plot(*scene.anchor_positions.T, "^", color="tab:green", ms=7)
        for name in names:
            place = truth.agents[name].trajectory.position_m[last]
            axis.plot(*place, "o", color="tab:orange", ms=6)
            axis.annotate(name, place, textcoords="offset points", xytext=(5, 4), fontsize=8)
        axis.set(title=title, xlabel="x (m)")
    axes[0].set_ylabel("y (m)")
    figure.colorbar(shown, ax=axes, label="change of log odds at this step", shrink=0.85)
    figure.savefig(Path(__file__).parent / "shared-grid.png", dpi=110)


if __name__ == "__main__":
    main()
