"""Judge the front end by itself: what it finds in snapshots of one path, of two, and of none, and how well.

``python docs/front_end.py [SNAPSHOTS]`` writes docs/front-end.png and prints its figures: one antenna, 41
frequencies 10 MHz apart, noise of unknown power, 0.1 false alarms per snapshot asked for. A minute for 300.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import gridslam as gs
from gridslam.evaluation.signal_bounds import distance_information
from gridslam.inference.messages.samples.signal_likelihood import Band

FREQUENCY_HZ = 1e7 * (np.arange(41) - 20)
BAND = Band.of(FREQUENCY_HZ)
SNRS_DB = 6, 8, 10, 12, 14, 17, 20, 25, 30, 40
GAPS_M = 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5
PAIR_SNRS_DB = 20, 30, 40
WITHIN_M = 0.3
NOT_ENOUGH = 30
"""Pairs found, below which their errors aren't shown."""


def snapshots(rng, length_m, snr_db):
    """Recording of one anchor and length_m (K, L), equal strengths and random phases; amplitudes (K, L)."""
    turn = np.exp(2j * np.pi * rng.random(length_m.shape))
    amplitude = 10 ** (snr_db / 20) * turn
    noise = rng.normal(size=(2, len(length_m), 41)) * np.sqrt(0.5)
    samples = np.einsum("kl,klm->km", amplitude, BAND.response(length_m)) + noise[0] + 1j * noise[1]
    return gs.Recording.from_arrays(samples[:, None], 6e9, FREQUENCY_HZ, ["A"]), amplitude


def bounds(length_m, amplitude):
    """Cramer-Rao bounds (K, L) of the lengths where amplitudes are unknown and the number is known, m."""
    power = 1e4 * np.abs(amplitude) ** 2  # amplitudes of which nothing is known
    each = zip(length_m, amplitude, power, strict=True)
    return np.sqrt([np.linalg.inv(distance_information(BAND, *one)).diagonal() for one in each])


def matched(recording, length_m, within_m):
    """Errors and claims (K, L) of the paths found nearest to each true one, NaN where none is; how many
    others were found."""
    heard = gs.extract(recording, false_alarms=0.1)
    error, claim = np.full((2, *length_m.shape), np.nan)
    others = len(heard.step)
    for number, true in enumerate(length_m):
        rows = np.flatnonzero(heard.step == number)
        for path in np.argsort(true):
            if not len(rows):
                break
            off = heard.distance_m[rows] - true[path]
            nearest = int(np.abs(off).argmin())
            if abs(off[nearest]) < within_m:
                error[number, path], claim[number, path] = off[nearest], heard.distance_std_m[rows[nearest]]
                rows, others = np.delete(rows, nearest), others - 1
    return error, claim, others


def judged(rng, length_m, snr_db, within_m):
    """Share of snapshots in which all is found, others per snapshot, errors over claims and over bounds."""
    recording, amplitude = snapshots(rng, length_m, snr_db)
    error, claim, others = matched(recording, length_m, within_m)
    whole = np.isfinite(error).all(1)
    if whole.sum() < NOT_ENOUGH:
        return whole.mean(), others / len(whole), np.nan, np.nan
    best = bounds(length_m[whole], amplitude[whole])
    over = [float(np.sqrt(np.mean((error[whole] / by) ** 2))) for by in (claim[whole], best)]
    return whole.mean(), others / len(whole), *over


def main() -> None:
    """Measure, print and draw."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    rng = np.random.default_rng(1)
    noise, _ = snapshots(rng, np.full((4 * count, 1), 5.0), -300.0)
    alone = len(gs.extract(noise, false_alarms=0.1).step) / (4 * count)
    print(f"noise alone: {alone:.3f} paths per snapshot (asked 0.1)")
    single = np.array([judged(rng, rng.uniform(2, 28, (count, 1)), snr, WITHIN_M) for snr in SNRS_DB])
    print("one path: SNR (dB), found, others, errors over claims, over the bound")
    for snr, row in zip(SNRS_DB, single, strict=True):
        print(f"{snr:5} {row[0]:6.0%} {row[1]:6.2f} {row[2]:6.2f} {row[3]:6.2f}")
    pairs = {}
    for snr in PAIR_SNRS_DB:
        print(f"two paths, {snr} dB: apart (m), both found, others, errors over claims, over the bound")
        rows = []
        for gap in GAPS_M:
            first = rng.uniform(2, 26, (count, 1))
            rows.append(judged(rng, np.hstack([first, first + gap]), snr, max(0.1, 0.5 * gap)))
            print(f"{gap:5} {rows[-1][0]:6.0%} {rows[-1][1]:6.2f} {rows[-1][2]:6.2f} {rows[-1][3]:6.2f}")
        pairs[snr] = np.array(rows)
    draw(alone, single, pairs)


def draw(alone, single, pairs) -> None:
    """Four panels: found and errors, over SNR and over separation."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained", sharex="col")
    (found, both), (errors, pair_errors) = axes
    found.plot(SNRS_DB, single[:, 0], "o-", color="tab:blue", label="found")
    found.plot(SNRS_DB, single[:, 1], "s--", color="tab:orange", label="others per snapshot")
    found.axhline(alone, color="0.5", lw=1, ls=":", label="in noise alone")
    found.set(title="one path", ylabel="share, or paths", ylim=(0, 1.05))
    errors.plot(SNRS_DB, single[:, 2], "o-", color="tab:blue", label="over claimed deviations")
    errors.plot(SNRS_DB, single[:, 3], "^--", color="tab:green", label="over the bound")
    errors.set(xlabel="SNR over all samples (dB)", ylabel="rms error, in ratio", ylim=(0, 1.6))
    for (snr, rows), color in zip(pairs.items(), ("tab:blue", "tab:orange", "tab:green"), strict=True):
        both.plot(GAPS_M, rows[:, 0], "o-", color=color, label=f"{snr} dB")
        pair_errors.plot(GAPS_M, rows[:, 2], "o-", color=color, label=f"{snr} dB, over claims")
        pair_errors.plot(
            GAPS_M, rows[:, 3], "^--", color=color, mfc="none", label=f"{snr} dB, over the bound"
        )
    both.set(title="two paths of equal strength", ylabel="both found", ylim=(0, 1.05))
    pair_errors.set(xlabel="apart (m)", ylabel="rms error, in ratio", ylim=(0, 1.6), xscale="log")
    ticks = [0.1, 0.2, 0.5, 1.0, 1.5]
    pair_errors.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    for axis in (both, pair_errors):
        axis.axvline(BAND.resolution_m, color="0.5", lw=1, ls=":")
    both.text(BAND.resolution_m * 1.03, 0.05, "c/B", color="0.4")
    for axis in (errors, pair_errors):
        axis.axhline(1, color="0.7", lw=1)
    for axis in axes.ravel():
        axis.grid(alpha=0.2)
        axis.legend(fontsize=7, loc="center right" if axis is found else "lower right")
    figure.savefig(Path(__file__).parent / "front-end.png", dpi=110)


if __name__ == "__main__":
    main()
