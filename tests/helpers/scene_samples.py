"""Bundled scenes made small, for tests that run the whole filter."""

import gridslam as gs


def shortened(scene, steps, agents=1):
    """A scene with `steps` steps per agent; further agents go the first one's way."""
    data = scene.model_dump(exclude_none=True)
    first = {**data["agents"][0], "steps": steps}
    data["agents"] = [{**first, "name": f"agent{number + 1}"} for number in range(agents)]
    return gs.Scene.checked(data, data["name"])
