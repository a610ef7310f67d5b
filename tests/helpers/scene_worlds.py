"""A small world of two walls, as the tables of a scene file, and changes to it."""

import copy

import tomli_w

WORLD = {
    "grid": {"x_m": [-5.0, 5.0], "y_m": [-4.0, 4.0], "cell_m": 0.1},
    "materials": {"concrete": 0.7, "glass": 0.3},
    "anchors": [
        {"name": "A", "position_m": [-2.0, 1.0], "orientation_deg": 90.0},
        {"name": "B", "position_m": [2, 1], "orientation_deg": 270.0},
    ],
    "walls": [
        {"material": "concrete", "points_m": [[-4.0, 3.0], [4.0, 3.0], [4.0, -3.0]]},
        {
            "material": "glass",
            "arc": {"centre_m": [0.0, 0.0], "radius_m": 3.5, "from_deg": 180.0, "to_deg": 225.0},
        },
    ],
    "agents": [{"name": "agent1", "start_m": [0.0, 0.0], "waypoints_m": [[2.0, 0.0], [2.0, -2.0]]}],
}


def changed(change):
    world = copy.deepcopy(WORLD)
    change(world)
    return tomli_w.dumps(world)


def put(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(world):
        for key in keys:
            world = world[key]
        world[last] = value

    return change


def rename(*keys_and_name):
    *keys, old, new = keys_and_name

    def change(world):
        for key in keys:
            world = world[key]
        world[new] = world.pop(old)

    return change


def drop(*keys):
    def change(world):
        for key in keys[:-1]:
            world = world[key]
        del world[keys[-1]]

    return change
