"""How far a run is, before its first step and after."""

import io

from rich.console import Console

import gridslam as gs
from gridslam.runs.progress import progress_bar


def shown(steps):
    """What a terminal shows of a run after so many steps."""
    scene = gs.Scene.load("room").with_filter(particles=100)
    slam, text = gs.AdaptiveSlam(scene), io.StringIO()
    with progress_bar("me", console=Console(file=text, force_terminal=True, width=140)) as tell:
        for done, scan in enumerate(list(gs.simulate(scene, "agent1", 1))[:steps], 1):
            tell(slam.step(scan), done, 190)
    return text.getvalue()


def test_what_takes_time_before_the_first_step_is_said_and_is_no_part_of_the_rate():
    assert "loading kernels (compiling them, the first time)" in shown(0)
    assert "first step" in shown(1)
    assert "steps/s" not in shown(1)
    assert "steps/s" in shown(2)
