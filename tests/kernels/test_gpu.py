"""Arrays that stay on the device, and a GPU's results against the CPU's where there is one."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from tiny import TINY

import gridslam as gs
from gridslam import runtime
from gridslam.bench import kernels as bench_kernels
from gridslam.kernels import CELL_SLABS

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

FOLLOW = """
import json, sys
import numpy as np
import gridslam as gs
from gridslam import runtime
from gridslam.errors import InputError
try:
    device = runtime.start(sys.argv[1])
except InputError as error:
    print(json.dumps({"error": str(error)}))
    sys.exit()
scene = gs.Scene.from_toml(sys.stdin.read())
slam = gs.GridSlam(scene, seed=1)
for scan in gs.simulate(scene, "agent1", 1):
    seen = slam.step(scan)
print(json.dumps({
    "device": device, "position": seen.position_m.tolist(), "heading": float(seen.heading_rad),
    "existence": seen.surfaces.existence.tolist(), "evidence": slam.state.grid.evidence.tolist(),
}))
"""


def follow(device, **environment):
    """What a filter in a process of its own believes in the end."""
    result = subprocess.run(
        [sys.executable, "-c", FOLLOW, device], input=TINY, capture_output=True, text=True, check=True,
        env={**os.environ, **environment},
    )  # fmt: skip
    return json.loads(result.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_gpu_agrees_with_the_cpu():
    on_gpu = follow("gpu")
    if "error" in on_gpu:
        pytest.skip("no CUDA or Vulkan device")
    on_cpu = follow("cpu")
    assert (on_gpu["device"], on_cpu["device"]) == ("gpu", "cpu")
    np.testing.assert_allclose(on_gpu["position"], on_cpu["position"], atol=1e-3)
    assert on_gpu["heading"] == pytest.approx(on_cpu["heading"], abs=1e-3)
    np.testing.assert_allclose(on_gpu["existence"], on_cpu["existence"], atol=1e-3)
    gap = np.abs(np.subtract(on_gpu["evidence"], on_cpu["evidence"]))
    assert np.mean(gap > 0.05) < 0.01


@pytest.mark.slow
def test_a_gpu_that_cannot_be_had_is_an_error():
    result = follow("gpu", CUDA_VISIBLE_DEVICES="", VK_DRIVER_FILES="/none", VK_ICD_FILENAMES="/none")
    assert "device" in result["error"]
    assert "gpu" in result["error"]


def test_resident_arrays_change_nothing(monkeypatch):
    scene, beliefs = gs.Scene.from_toml(TINY), []
    for device, slabs in (("cpu", 4), ("gpu", 4), ("gpu", CELL_SLABS["gpu"])):
        runtime.start()
        with monkeypatch.context() as patch:
            # the kernels stay those of the CPU, the arrays are kept as for a GPU
            patch.setattr(runtime, "_started", device)
            # messages add up in single precision, in an order that follows the slabs
            patch.setitem(CELL_SLABS, device, slabs)
            slam = gs.GridSlam(scene, seed=1)
            for scan in gs.simulate(scene, "agent1", 1):
                slam.step(scan)
            assert isinstance(slam.work.require_cells().scratch.message, np.ndarray) == (device == "cpu")
        belief = slam.state.belief
        beliefs.append((belief.mean, belief.covariance, slam.state.grid.evidence))
    for near, far in zip(*beliefs[:2], strict=True):
        np.testing.assert_allclose(near, far, rtol=1e-9, atol=1e-9)
    for near, far in zip(beliefs[0], beliefs[2], strict=True):
        np.testing.assert_allclose(near, far, rtol=1e-3, atol=1e-3)
    assert beliefs[0][2].any()


@pytest.mark.slow
def test_kernels_compete_with_arrays_that_stay_on_a_device_too(monkeypatch):
    runtime.start()
    monkeypatch.setattr(runtime, "_started", "gpu")
    cases = bench_kernels.largest_launches(gs.Scene.from_toml(TINY), 1, 2)
    for name in ("fold_messages", "cast", "evaluate", "learn"):
        assert not all(
            isinstance(value, np.ndarray) for value in cases[name].values() if hasattr(value, "shape")
        )
        speed = bench_kernels.compete(name, "tiny", cases[name], 0.0)
        assert speed.units > 0
        assert 0 < speed.kernel_best_s <= speed.kernel_s
