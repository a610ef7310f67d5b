"""Parts of the evaluation kernel, launched by themselves."""

from functools import cache


@cache
def stages():
    """Kernels (weigh and gate, densities, enter); arguments as of `kernels.messages.evaluation`."""
    import taichi as ti

    from gridslam.kernels.messages.association import enter
    from gridslam.kernels.messages.gating import gate
    from gridslam.kernels.propagation.amplitudes import weigh
    from gridslam.kernels.propagation.paths import densities

    whole, row = ti.types.ndarray(dtype=ti.i32, ndim=2), ti.types.ndarray(dtype=ti.i32, ndim=1)
    single, line = ti.types.ndarray(dtype=ti.f32, ndim=2), ti.types.ndarray(dtype=ti.f64, ndim=1)
    double, cube = ti.types.ndarray(dtype=ti.f64, ndim=2), ti.types.ndarray(dtype=ti.f64, ndim=3)

    @ti.kernel
    def gated(
        belief: double, nodes: line, spreading: ti.f64, path: whole, predicted: double, heard: double,
        chance: line, step: ti.f64, radio: double, kept: ti.f64, density: cube, strength: cube, odds: double,
        start: row, index: whole, pair: double, table: single, measured: double,
    ):  # fmt: skip
        for _ in range(1):
            weigh(
                belief, nodes, spreading, path, predicted, heard, chance, step, radio, density, strength, odds
            )  # fmt: skip
            gate(path, predicted, heard, radio, kept, odds, strength, start, index, pair, table, measured)

    @ti.kernel
    def summed(
        state: single, head: ti.i32, path: whole, places: double, start: row, table: single, blocks: single
    ):
        for block in range(blocks.shape[1]):
            densities(block, head, state, path, places, start, table, blocks)

    @ti.kernel
    def entered(
        blocks: single, start: row, index: whole, pair: double, odds: double, message: cube, measured: double
    ):
        for _ in range(1):
            enter(blocks, start, index, pair, odds, message, measured)

    return gated, summed, entered
