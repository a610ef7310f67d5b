"""Bundled scenes made small, for tests that run the whole filter."""

import numpy as np

import gridslam as gs

ENOUGH = 512
"""Particles of scenes that are made small: what filters find is the same with 10 000, and steps take twice as
long."""


def shortened(scene, steps, agents=1):
    """A scene with `steps` steps per agent, and fewer particles; further agents go the first one's way."""
    data = scene.model_dump(exclude_none=True)
    data["filter"]["particles"] = min(data["filter"]["particles"], ENOUGH)
    first = {**data["agents"][0], "steps": steps}
    data["agents"] = [{**first, "name": f"agent{number + 1}"} for number in range(agents)]
    return gs.Scene.checked(data, data["name"])


def short(name, steps, particles=None):
    """A bundled scene, with so many steps of each of its agents, and so many particles."""
    data = gs.Scene.load(name).model_dump(exclude_none=True)
    for agent in data["agents"]:
        agent["steps"] = steps
    if particles is not None:
        data["filter"]["particles"] = particles
    return gs.Scene.checked(data, name)


def with_levels(scene, floor=(0.0, 0.5), ceiling=(3.0, 0.4)):
    """The scene with floor and ceiling, (height, coefficient) each."""
    levels = {
        name: {"height_m": height, "coefficient": own}
        for name, (height, own) in (("floor", floor), ("ceiling", ceiling))
    }
    return gs.Scene.checked({**scene.model_dump(exclude_none=True), **levels}, scene.name)


def raised(scene, above_m, agent_m=1.0):
    """The scene with its agents at a height, and each anchor so much above them (one number, or J)."""
    data = scene.model_dump(exclude_none=True)
    for anchor, above in zip(data["anchors"], np.broadcast_to(above_m, len(scene.anchors)), strict=True):
        anchor["position_m"] = (*anchor["position_m"][:2], agent_m + float(above))
    for agent in data["agents"]:
        agent["height_m"] = agent_m
    return gs.Scene.checked(data, scene.name)


def tall(layers=5, levels=True, steps=30, height_std_m=0.0, **radio):
    """`room`, anchors 1.5 m above the agent, with arrays of so many layers, floor and ceiling."""
    data = raised(shortened(gs.Scene.load("room"), steps), 1.5).model_dump(exclude_none=True)
    own = data["agents"][0]["height_m"]
    if levels:
        data["floor"] = {"height_m": own - 1.1, "coefficient": 0.5}
        data["ceiling"] = {"height_m": own + 1.9, "coefficient": 0.4}
    data["agents"][0]["height_std_m"] = height_std_m
    data["radio"] |= {"array": data["radio"]["array"] | {"layers": layers}, **radio}
    return gs.Scene.checked(data, "room")


def replace_layers(scene, layers):
    data = scene.model_dump(exclude_none=True)
    data["radio"]["array"]["layers"] = layers
    return gs.Scene.checked(data, scene.name)
