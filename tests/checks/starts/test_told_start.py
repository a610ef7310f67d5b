"""A heading that the first lines of sight contradict is named."""

from dataclasses import replace

import numpy as np
import pytest
from scene_samples import short

import gridslam as gs
from gridslam.checks.verdicts.diagnose import suspicions
from gridslam.world.geometry import wrap


@pytest.mark.slow
@pytest.mark.parametrize(("name", "off_deg"), [("room", -30), ("alcove", 30)])
def test_arrivals_or_a_start_heading_that_are_30_degrees_off_are_suspected(name, off_deg):
    """They were followed back to the right heading within some steps, and nothing was said."""
    scene, off = short(name, 60), np.radians(off_deg)
    heard = gs.simulate(scene, "agent1", 1)
    assert suspicions(dict(heard.columns), heard.anchors, scene, "agent1") == []
    turned = replace(heard, aoa_rad=wrap(heard.aoa_rad + off))
    body = scene.agent("agent1")
    elsewhere = scene.starting("agent1", body.start_m, np.radians(body.start_heading_deg) + off)
    for table, world in ((turned, scene), (heard, elsewhere)):
        (found,) = suspicions(dict(table.columns), table.anchors, world, "agent1")
        assert (found.column, found.kind, found.certain) == ("start", "start", False)
        assert f"start_heading_deg of {world.agent('agent1').start_heading_deg:g}" in found.text
        assert "counted from another axis of the agent" in found.text
