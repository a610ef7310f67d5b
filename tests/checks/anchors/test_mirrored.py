"""Both angles clockwise at once, or a scene that is mirrored: one line of `check` that says both."""

import pytest
from lab_samples import ANCHORS, heard, lab, suspected

NAMES = tuple(ANCHORS)


@pytest.mark.slow
@pytest.mark.parametrize("walls", [True, False])
def test_a_mirrored_scene_is_one_suspicion(walls):
    right = heard(NAMES)
    scene = lab(NAMES, walls=walls)
    (found,) = suspected(right | {name: -right[name] for name in ("aod_rad", "aoa_rad")}, scene)
    assert (found.column, found.kind) == ("aod_rad", "mirrored")
    assert "and so is aoa_rad; or the scene is mirrored" in found.text
    assert suspected(right, scene) == []
