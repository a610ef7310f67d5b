"""Studies of made-up runs: what a run would write, without one."""

from functools import lru_cache

import gridslam as gs
from gridslam.evaluation.consistency import true_rays
from gridslam.evaluation.surface_truth import AudibleSurfaces
from gridslam.studies.study import Study
from gridslam.world.scene import Scene

AGENTS = ("agent1", "agent2")


def plan(scene, seeds=4, **more):
    return Study((scene,), seeds=tuple(range(seeds)), **more)


@lru_cache
def true_course(toml, names):
    """Steps, surfaces and true rays of the last of these agents."""
    scene = Scene.from_toml(toml, "tiny")
    *earlier, truth = (gs.ground_truth(scene, name) for name in names)
    surfaces = len(AudibleSurfaces.of(truth, earlier).feature)
    return len(truth.trajectory), surfaces, true_rays(scene, names[-1], truth)


def made_up(job, position=0.02):
    """Record of a run that never was: every error is `position` (m) or 0.01 rad."""
    agents = {}
    for number, name in enumerate(job.agents):
        size, surfaces, rays = true_course(job.variant.scene, job.agents[: number + 1])
        steps = {
            "position_error_m": [position * (1 + job.seed)] * size,
            "heading_error_rad": [-0.01] * size,
            "position_nees": [2.0] * size,
            "heading_nees": [1.0] * size,
            "position_claimed_m": [0.03] * size,
            "surface_ospa_m": [0.5] * size,
            "image_ospa_m": [0.25] * size,
            "surfaces": [surfaces] * size,
            "surface_error_m": [[None if job.seed == 0 else 0.1] * size] * surfaces,
            "rays": (rays + 1).tolist(),
            "ray_belief": rays.tolist(),
        }
        scores = {"steps": size, "diverged": job.seed == 1, "map": {"auc": None}, "reflection_mae": 0.25}
        agents[name] = {
            "cost": {"seconds_per_step": 0.5, "peak_memory_mb": 9.0},
            "scores": scores,
            "steps": steps,
        }
    return {"key": job.key, "agents": agents}


class Here:
    """Workers that make runs up, in this process, and count them; `fate` may break one."""

    def __init__(self, fate=None):
        self.done, self.fate = [], fate or {}

    def run(self, work, tasks):
        for index, job in reversed(list(enumerate(tasks))):
            end = self.fate.get(job.seed)
            if isinstance(end, KeyboardInterrupt):
                raise end
            self.done.append(job.seed)
            yield index, end or made_up(job)
