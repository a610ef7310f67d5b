"""Start-up, in processes of its own, and the machine that all is measured on."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
import psutil

from gridslam import runtime

PACKAGES = ("gridslam", "taichi", "numpy", "scipy", "h5py")

IMPORT = """
import time
began = time.perf_counter()
import gridslam
took = time.perf_counter() - began
import json, sys
print(json.dumps([took, "taichi" in sys.modules]))
"""
"""What a user's `import gridslam` costs, once the interpreter is there."""

FIRST_STEP = """
import contextlib, sys, time
import gridslam.runs.progress

@contextlib.contextmanager
def stop_at_first_step(*_):
    def tell(*_):
        sys.stdout.write(repr(time.time()))
        raise SystemExit(0)
    yield tell

gridslam.runs.progress.progress_bar = stop_at_first_step
from gridslam.cli.main import main
main()
"""
"""`gridslam run`, which says when its first step is done and leaves then."""


@dataclass(frozen=True)
class StartUp:
    """Start-up of fresh processes.

    Attributes
    ----------
    import_s : float
        Median time of ``import gridslam`` in a running interpreter.
    import_starts_taichi : bool
        Whether that import brings Taichi along.
    cold_s : float
        Time from the command ``gridslam run room`` to its first step, without compiled kernels.
    warm_s : float
        The same with compiled kernels.
    """

    import_s: float
    import_starts_taichi: bool
    cold_s: float
    warm_s: float


@dataclass(frozen=True)
class Machine:
    """What was measured on.

    Attributes
    ----------
    cpu : str
        Processor.
    system : str
        Operating system.
    python : str
        Version of Python.
    cores : int
        Logical cores that this process may use.
    memory_gb : float
        Memory of the machine.
    load : float or None
        Mean number of running processes in the minute before, where the system tells.
    device : str
        Where the kernels really ran.
    threads : int
        Threads of the kernels, on a CPU.
    versions : dict
        Versions of the packages that matter.
    """

    cpu: str
    system: str
    python: str
    cores: int
    memory_gb: float
    load: float | None
    device: str
    threads: int
    versions: dict[str, str]


def machine(device: str) -> Machine:
    """Describe this machine; Taichi has to run.

    Parameters
    ----------
    device : str
        What `runtime.start` returned.
    """
    from gridslam.kernels.primitives import taichi_inside

    allowed = getattr(os, "sched_getaffinity", None)
    return Machine(
        cpu=_cpu(),
        system=platform.platform(terse=True),
        python=platform.python_version(),
        cores=len(allowed(0)) if allowed else os.cpu_count() or 1,
        memory_gb=psutil.virtual_memory().total / 2**30,
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        device=device,
        threads=taichi_inside.threads(),
        versions={name: metadata.version(name) for name in PACKAGES},
    )


def start_up(repeats: int, device: str = "auto") -> StartUp:
    """Measure the start-up; the first import of all, which reads files from the disk, isn't counted.

    Parameters
    ----------
    repeats : int
        Imports, and starts with compiled kernels, of which the medians are taken.
    device : str
    """
    _child(IMPORT, [])
    imports = [json.loads(_child(IMPORT, [])) for _ in range(repeats)]
    with tempfile.TemporaryDirectory(prefix="gridslam-bench-") as folder:
        cache = {"TI_OFFLINE_CACHE_FILE_PATH": str(Path(folder) / "kernels")}
        words = ["run", "room", "--device", device, "-o", str(Path(folder) / "run")]
        cold = _until_first_step(words, cache)
        warm = [_until_first_step(words, cache) for _ in range(repeats)]
    return StartUp(
        float(np.median([took for took, _ in imports])),
        any(started for _, started in imports),
        cold,
        float(np.median(warm)),
    )


def _until_first_step(words: list[str], environment: dict[str, str]) -> float:
    began = time.time()
    return float(_child(FIRST_STEP, words, environment)) - began


def _child(code: str, words: list[str], environment: dict[str, str] | None = None) -> str:
    """Standard output of a fresh interpreter that imports this very package."""
    home = str(Path(runtime.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [home, os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        env={**os.environ, **(environment or {}), "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"start-up failed: {done.stderr.strip()[-500:]}")
    return done.stdout


def _cpu() -> str:
    """Model of the processor, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for line in lines:
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or platform.machine()
