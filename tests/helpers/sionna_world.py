"""Traces a scene with the real Sionna RT, in a process of its own.

``sionna_world.py SCENE STEP FILE.npz [BUILDING[+through]]``: LLVM ends the whole process where it is too old
for Dr.Jit (DRJIT_LIBLLVM_PATH names another one), so the tests don't import this. In the building "plane"
walls have no end and all devices one height.
"""

import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

THICKNESS_M = {"glass": 0.01, "plasterboard": 0.025, "metal": 0.005}
"""Others: 0.2."""


@dataclass(frozen=True)
class Building:
    """What the walls of a scene file leave open, heights in m above the floor.

    Attributes
    ----------
    floor, ceiling : float
    low : dict
        Tops of walls that don't reach the ceiling, by the first word of their names.
    anchor, agent : float
    flat : bool
        Neither floor nor ceiling reflects.
    through : bool
        Whether paths go through walls.
    """

    floor: float = -3.0
    ceiling: float = 3.0
    low: dict = field(default_factory=dict)
    anchor: float = 0.0
    agent: float = 0.0
    flat: bool = True
    through: bool = False


OFFICE = Building(0.0, 3.0, anchor=1.8, agent=1.3, flat=False)
WAREHOUSE = Building(0.0, 7.0, {"shelf": 4.5}, anchor=2.2, agent=1.5, flat=False)
BUILDINGS = {"plane": Building(), "office": OFFICE, "warehouse": WAREHOUSE}


def upright(start, end, low, high):
    """Rectangles over pieces of walls, (N, 4, 3); tops (N,)."""
    floor = np.full((len(start), 1), low)
    heights = np.reshape(high, (-1, 1))
    corners = ((start, floor), (end, floor), (end, heights), (start, heights))
    return np.stack([np.hstack(corner) for corner in corners], 1)


def mesh(path, corners):
    """Rectangles (N, 4, 3) as PLY."""
    faces = np.concatenate([4 * np.arange(len(corners))[:, None] + k for k in ([0, 1, 2], [0, 2, 3])])
    lines = ["ply", "format ascii 1.0", f"element vertex {4 * len(corners)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(repr(float(x)) for x in point) for point in corners.reshape(-1, 3)]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def surfaces(scene, building):
    """Rectangles of each material, {name: (N, 4, 3)}."""
    walls = scene.segments()
    material = np.array([scene.walls[wall].material for wall in walls.wall])
    first = [(scene.walls[wall].name or "").split(" ")[0] for wall in walls.wall]
    top = np.array([building.low.get(word, building.ceiling) for word in first])
    whole = {
        str(name): upright(walls.start[rows], walls.end[rows], building.floor, top[rows])
        for name in np.unique(material)
        for rows in [material == name]
    }
    if not building.flat:
        (left, right), (bottom, rear) = scene.grid.x_m, scene.grid.y_m
        corners = np.array([[left, bottom], [right, bottom], [right, rear], [left, rear]])
        level = [np.hstack([corners, np.full((4, 1), z)]) for z in (building.floor, building.ceiling)]
        whole["concrete"] = np.concatenate([whole.get("concrete", np.zeros((0, 4, 3))), level])
    return whole


def trace(scene, agent, step, building):
    """Paths between all anchors and every `step`-th place of the agent's track."""
    import sionna.rt as rt

    world = rt.load_scene()
    world.frequency = scene.radio.carrier_hz
    world.tx_array = world.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    with tempfile.TemporaryDirectory() as folder:
        objects = []
        for name, corners in surfaces(scene, building).items():
            file = Path(folder) / f"{name}.ply"
            mesh(file, corners)
            stuff = rt.ITURadioMaterial(f"stuff-{name}", name, thickness=THICKNESS_M.get(name, 0.2))
            objects.append(rt.SceneObject(fname=str(file), name=f"wall-{name}", radio_material=stuff))
        world.edit(add=objects)
    track = scene.track(agent)
    for number, anchor in enumerate(scene.anchors):
        turn = [float(scene.anchor_orientations[number]), 0.0, 0.0]
        place = [*anchor.position_m[:2], (*anchor.position_m, building.anchor)[2]]
        world.add(rt.Transmitter(f"anchor-{number}", position=place, orientation=turn))
    for number in range(0, len(track), step):
        own = scene.agent(agent).height_m
        place = [*map(float, track.position_m[number]), building.agent if own is None else own]
        turn = [float(track.heading_rad[number]), 0.0, 0.0]
        world.add(rt.Receiver(f"agent-{number:06d}", position=place, orientation=turn))
    samples = 100_000 if building.flat else 500_000
    return rt.PathSolver()(world, max_depth=2, samples_per_src=samples, refraction=building.through, seed=1)


if __name__ == "__main__":
    from dataclasses import replace

    from gridslam.world.scene import Scene

    name, _, through = (sys.argv[4] if len(sys.argv) > 4 else "plane").partition("+")
    place = replace(BUILDINGS[name], through=bool(through))
    paths = trace(Scene.load(sys.argv[1]), "agent1", int(sys.argv[2]), place)
    names = ("tau", "valid", "phi_t", "phi_r", "theta_t", "theta_r")
    gain = np.array([part.numpy() for part in paths.a])
    np.savez(sys.argv[3], a=gain, **{name: getattr(paths, name).numpy() for name in names})
