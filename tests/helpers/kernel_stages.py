"""Parts of the evaluation kernel, launched by themselves."""

from functools import cache


@cache
def stages():
    """Kernels (weigh and gate, densities, enter); arguments as of `kernels.messages.evaluation`."""
    import taichi as ti

    from gridslam.kernels.messages.association import enter
    from gridslam.kernels.messages.evaluation import gate
    from gridslam.kernels.primitives.blocks import Amplitudes, Gating, Pairs, PathRows, Ratios
    from gridslam.kernels.primitives.launching import quick
    from gridslam.kernels.primitives.packing import pack
    from gridslam.kernels.propagation.amplitudes import weigh
    from gridslam.kernels.propagation.paths import densities

    whole, row = ti.types.ndarray(dtype=ti.i32, ndim=2), ti.types.ndarray(dtype=ti.i32, ndim=1)
    single = ti.types.ndarray(dtype=ti.f32, ndim=2)
    double, cube = ti.types.ndarray(dtype=ti.f64, ndim=2), ti.types.ndarray(dtype=ti.f64, ndim=3)

    @quick
    @ti.kernel
    def gated(
        spreading: ti.f64, step: ti.f64, kept: ti.f64, amplitudes: pack(Amplitudes), rows: pack(PathRows),
        scan: double, places: double, radio: double, scratch: pack(Gating), pairs: pack(Pairs),
        ratios: pack(Ratios),
    ):  # fmt: skip
        for _ in range(1):
            weigh(amplitudes, spreading, step, rows, scan, radio, scratch, ratios.odds)
            gate(rows, scan, places, radio, kept, scratch, pairs, ratios)

    @ti.kernel
    def summed(
        state: single, head: ti.i32, path: whole, places: double, start: row, table: single, odds: double,
        blocks: single,
    ):  # fmt: skip
        for block in range(blocks.shape[1]):
            densities(block, head, state, path, places, start, table, odds, blocks)

    @ti.kernel
    def entered(
        blocks: single, start: row, index: whole, pair: double, odds: double, message: cube, measured: double
    ):
        for _ in range(1):
            enter(blocks, start, index, pair, odds, message, measured)

    return gated, summed, entered
