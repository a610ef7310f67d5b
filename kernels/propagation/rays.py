"""Rays: which paths there may be, as they are predicted, and which measurements lie near; (M20), (M21)."""

import taichi as ti

from gridslam.kernels import ALREADY_LISTED
from gridslam.kernels.primitives.blocks import (
    APPEAR,
    HEAD,
    MOST_BOUNCES,
    OFFSET,
    ONLY,
    ROOTED,
    SENDERS,
    SHARE,
    STAY,
    Belief,
    Draft,
    Links,
    Listed,
    Query,
)
from gridslam.kernels.primitives.functions import wrapped
from gridslam.kernels.primitives.gaussian import entry_of, path_of, predict_by, spread_by_unknown, spread_of
from gridslam.kernels.primitives.launching import copying
from gridslam.kernels.primitives.layout import ABOVE, LATE, anchor_of, unknown_entry
from gridslam.kernels.primitives.packing import pack
from gridslam.kernels.primitives.particles import ready
from gridslam.kernels.primitives.radio import (
    AGENT_APERTURE,
    ANCHOR_APERTURE,
    GIVEN,
    SCALE,
    SENDER,
    THRESHOLD,
    lean_of,
)
from gridslam.kernels.primitives.tables import AMPLITUDE, ANCHOR, BOUNCES, FIRST, LABEL, LAST, LOUD, OWN_STD

STRONG = 0.3
"""Existence from which on a surface may take part in a double bounce, and explain a loud measurement."""
GATE = 4.0
"""Standard deviations within which a measurement lies where its path is predicted."""
ROOT_8_PI = 8.885765876316732


@ti.func
def listed(kind, s, r, anchor, links: ti.template()):
    """Whether a path over so many surfaces is worth a look; existence of its ray, and of its surfaces."""
    there, chance, together = True, links.sight[anchor], ti.f64(1.0)
    if kind == 1:
        there = links.owner[s] == -1 or links.owner[s] == anchor
        chance, together = links.single[anchor, s], links.surface[s]
    elif kind == 2:
        there = s != r and links.surface[s] > STRONG and links.surface[r] > STRONG
        chance, together = links.double[anchor, s, r], links.surface[s] * links.surface[r]
    return there, chance, together


@ti.func
def enter_path(path: ti.template(), row, kind, s, r, anchor):
    """Write a row of a table of paths: bounces, last, first, anchor."""
    path[row, BOUNCES], path[row, ANCHOR] = kind, anchor
    path[row, LAST] = -1 if kind == 0 else s
    path[row, FIRST] = -1 if kind == 0 else (s if kind == 1 else r)


@ti.func
def list_and_predict(
    query: ti.template(), belief: ti.template(), places: ti.template(), links: ti.template(),
    draft: ti.template(), out: ti.template(),
):  # fmt: skip
    """Make ready to draw particles and samples; list paths and predict them, unless these are given.

    Arguments are those of `list_paths`.
    """
    only, bounces, head = query.choice[ONLY], query.choice[MOST_BOUNCES], query.choice[HEAD]
    stay, appear = query.weight[STAY], query.weight[APPEAR]
    ready(belief, head, query.weight[SHARE], query.choice[OFFSET], query.choice[ROOTED], draft)
    count, n, known = links.surface.shape[0], 0, only == ALREADY_LISTED
    begin, end = ti.max(only, 0), (0 if known else places.shape[0])
    for anchor in range(begin, end):
        own = only < 0 or anchor % query.choice[SENDERS] == only
        for kind in range((3 if bounces > 1 else 2) if own else 0):
            for s in range(1 if kind == 0 else count):
                for r in range(count if kind == 2 else 1):
                    there, chance, together = listed(kind, s, r, anchor, links)
                    if there:
                        enter_path(out.path, n, kind, s, r, anchor)
                        out.existence[n], out.surfaces[n] = appear + chance * (stay - appear), together
                        n += 1
    for row in range(n):
        predict_by(belief.mean, belief.covariance, head, out.path, places, row, out.predicted)
    out.found[0] = out.found[0] if known else n


@copying("belief", "links")
@ti.kernel
def list_paths(
    query: pack(Query),
    belief: pack(Belief),
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    links: pack(Links),
    draft: pack(Draft),
    out: pack(Listed),
):
    """List and predict paths: line of sight, single bounces, double bounces. Make ready to draw particles."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        list_and_predict(query, belief, places, links, draft, out)


@ti.func
def lies_near(m, value, spread, lean, scan: ti.template(), radio: ti.template(), anchor):
    """Whether a measurement lies where a path is predicted. Which way an array faces doesn't matter here."""
    there = 0.5 * (radio[anchor, ANCHOR_APERTURE] + radio[anchor, ANCHOR_APERTURE + 1])
    here = 0.5 * (radio[anchor, AGENT_APERTURE] + radio[anchor, AGENT_APERTURE + 1])
    amplitude = scan[m, AMPLITUDE] if scan[m, AMPLITUDE] >= 0 else radio[anchor, THRESHOLD]
    far = ti.f64(0.0)
    for q in ti.static(range(3)):
        gap, std = scan[m, q] - value[q], scan[m, OWN_STD + q]
        if ti.static(q > 0):
            gap = wrapped(gap)
        if std == 0:
            square = there if ti.static(q == 1) else here
            std = 1 / (ROOT_8_PI * amplitude * lean * ti.sqrt(ti.max(square, 1e-30)))
            if ti.static(q == 0):
                given = radio[anchor, GIVEN]
                std = given if given > 0 else radio[anchor, SCALE] / amplitude
        if std >= 0:  # what wasn't measured is near
            far += gap * gap / (spread[q, q] + std * std)
    return far < GATE * GATE


@copying("mean", "covariance", "surface", "owner")
@ti.kernel
def near(
    mean: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [N]
    covariance: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [N, N]
    head: ti.i32,  # entry of the mean where the lines begin: see `layout`
    places: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 6] anchors: see `blocks`
    surface: ti.types.ndarray(dtype=ti.f64, ndim=1),  # [S] existence
    owner: ti.types.ndarray(dtype=ti.i64, ndim=1),  # [S] the one anchor that a surface serves; -1 for all
    scan: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [M, 10] of all anchors: see `AnchorScan.table`
    radio: ti.types.ndarray(dtype=ti.f64, ndim=2),  # [J, 12] see `radio`
    claimed: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [M] out: 1 where a loud measurement lies near a path
):
    """Find the loud measurements that lie where a line of sight or a single bounce is predicted."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for m in range(scan.shape[0]):
            claimed[m] = 0
        for anchor in range(places.shape[0]):
            place = anchor_of(places, mean, head, anchor)
            for n in range(surface.shape[0] + 1):
                s, bounces, there = n - 1, (0 if n == 0 else 1), True
                if n > 0:
                    there = surface[s] > STRONG and (owner[s] == -1 or owner[s] == anchor)
                if there:
                    value, slope = path_of(mean, head, place, bounces, s, s)
                    entry, unknown = entry_of(head, bounces, s, s), unknown_entry(places, head, anchor)
                    spread = spread_of(slope, entry, covariance)
                    if unknown >= 0:
                        spread += spread_by_unknown(
                            slope, entry, unknown, place, value[0] - place[LATE], covariance
                        )
                    lean = lean_of(value[0] - place[LATE], place[ABOVE])
                    for m in range(scan.shape[0]):
                        if scan[m, LOUD] > 0.5 and (
                            scan[m, LABEL] < 0 or scan[m, LABEL] == radio[anchor, SENDER]
                        ):
                            if lies_near(m, value, spread, lean, scan, radio, anchor):
                                claimed[m] = 1
