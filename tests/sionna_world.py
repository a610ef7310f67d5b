"""Traces a scene with the real Sionna RT, in a process of its own: ``sionna_world.py SCENE STEP FILE.npz``.

LLVM ends the whole process where it is too old for Dr.Jit, so the tests don't import this.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

HEIGHT_M = 3.0
MATERIALS = {"glass": "glass"}


def mesh(path, start, end):
    """Upright rectangles over pieces of walls, as PLY."""
    low, high = np.full((len(start), 1), -HEIGHT_M), np.full((len(start), 1), HEIGHT_M)
    corners = np.stack(
        [np.hstack([p, z]) for p, z in ((start, low), (end, low), (end, high), (start, high))], 1
    )
    faces = np.concatenate([4 * np.arange(len(start))[:, None] + k for k in ([0, 1, 2], [0, 2, 3])])
    lines = ["ply", "format ascii 1.0", f"element vertex {4 * len(start)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(repr(float(x)) for x in point) for point in corners.reshape(-1, 3)]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def trace(scene, agent, step):
    """Paths between all anchors and every `step`-th place of the agent's track."""
    import sionna.rt as rt

    walls, world = scene.segments(), rt.load_scene()
    world.frequency = scene.radio.carrier_hz
    world.tx_array = world.rx_array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    material = np.array([scene.walls[wall].material for wall in walls.wall])
    with tempfile.TemporaryDirectory() as folder:
        objects = []
        for number, name in enumerate(np.unique(material)):
            file, rows = Path(folder) / f"{number}.ply", material == name
            mesh(file, walls.start[rows], walls.end[rows])
            stuff = rt.ITURadioMaterial(f"stuff-{number}", MATERIALS.get(name, "concrete"), thickness=0.2)
            objects.append(rt.SceneObject(fname=str(file), name=f"wall-{number}", radio_material=stuff))
        world.edit(add=objects)
    track = scene.track(agent)
    for number, anchor in enumerate(scene.anchors):
        turn = [float(scene.anchor_orientations[number]), 0.0, 0.0]
        world.add(rt.Transmitter(f"anchor-{number}", position=[*anchor.position_m, 0.0], orientation=turn))
    for number in range(0, len(track), step):
        place, turn = (
            [*map(float, track.position_m[number]), 0.0],
            [float(track.heading_rad[number]), 0.0, 0.0],
        )
        world.add(rt.Receiver(f"agent-{number:06d}", position=place, orientation=turn))
    return rt.PathSolver()(world, max_depth=2, samples_per_src=100_000, refraction=False, seed=1)


if __name__ == "__main__":
    from gridslam.scene import Scene

    paths = trace(Scene.load(sys.argv[1]), "agent1", int(sys.argv[2]))
    names = ("tau", "valid", "phi_t", "phi_r", "theta_t", "theta_r")
    gain = np.array([part.numpy() for part in paths.a])
    np.savez(sys.argv[3], a=gain, **{name: getattr(paths, name).numpy() for name in names})
