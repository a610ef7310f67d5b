"""A height of all anchors, told beside rivals that explain as much."""

import gridslam as gs
from gridslam.checks.range_errors import RangeError
from gridslam.checks.range_fit import RangeFit
from gridslam.checks.rivals import _common_height


def test_a_height_is_told_although_a_small_offset_explains_as_much():
    scene = gs.Scene.load("room")
    every = tuple(range(len(scene.anchors)))
    height = RangeFit(RangeError("slant", every), 1.2, 588.0, 129)
    offset = RangeFit(RangeError("offset", every), 0.14, 597.0, 129)
    assert _common_height([offset, height], RangeFit(None, 0.0, 1023.0, 129), scene) is height
    assert _common_height([offset, height], RangeFit(None, 0.0, 800.0, 129), scene) is None
    assert _common_height([offset], RangeFit(None, 0.0, 1023.0, 129), scene) is None
