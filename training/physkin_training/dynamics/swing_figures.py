"""How points of a hem swing: amplitude and phase of a swinging root, overshoot and settling after a stop, twist and
flare in a turn, and how much moves at which rates.

Dimensions: `T` frames, `k` points. Metres, root frame.
"""

from __future__ import annotations

import numpy as np

from physkin_core.motion.motion import Motion

__all__ = ["OCTAVES", "hem_velocity", "octaves", "settling", "swing", "turning"]

LOWEST = 0.34
"""Share of the points, the lowest, that are looked at."""
SETTLED = 0.1
"""Cloth has settled when it stays within this share of the simulation's largest displacement after the stop."""
OCTAVES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""[Hz] the ends of the bands that are looked at."""
STEADY_FROM = 1.6
"""[s] from the beginning of a scene until the root's swing is steady."""


def swing(points: np.ndarray, motion: Motion, rate_hz: float) -> dict[str, float]:
    """Amplitude [mm] of the lowest points (of (T, k, 3)) sideways against the root, and phase [degrees] after the
    root's displacement, at the rate of the root."""
    sideways = _low(points)[:, :, 1].mean(axis=1)
    times = np.arange(len(sideways)) / motion.rate_hz
    steady = times >= STEADY_FROM
    basis = np.stack([np.sin(2 * np.pi * rate_hz * times), np.cos(2 * np.pi * rate_hz * times), np.ones_like(times)], 1)

    def fitted(signal: np.ndarray) -> complex:
        sine, cosine, _ = np.linalg.lstsq(basis[steady], signal[steady], rcond=None)[0]
        return complex(sine, cosine)

    cloth, root = fitted(sideways), fitted(motion.root_position[: len(sideways), 1].astype(np.float64))
    return {"amplitude_mm": 1000 * abs(cloth), "phase_degrees": float(np.degrees(np.angle(cloth / root)))}


def settling(points: np.ndarray, simulated: np.ndarray, motion: Motion) -> dict[str, float]:
    """After the root's stop: the largest displacement [mm] of the lowest points (of (T, k, 3)) from where they end, and
    the time [s] from which they stay within a tenth of the simulation's largest."""
    moves = np.abs(np.diff(motion.root_position[: len(points)], axis=0)).max(axis=1)
    turns = np.abs(np.diff(motion.root_orientation[: len(points)], axis=0)).max(axis=1)
    stop = int(np.flatnonzero(np.maximum(moves, turns) > 1e-5).max(initial=0)) + 1

    def displacement(of: np.ndarray) -> np.ndarray:
        low = _low(of)[stop:].astype(np.float64)
        return np.sqrt(((low - low[-1]) ** 2).sum(axis=2).mean(axis=1))

    own, limit = displacement(points), SETTLED * displacement(simulated).max()
    outside = np.flatnonzero(own > limit)
    return {
        "overshoot_mm": 1000 * float(own.max()),
        "settling_s": float((outside.max() + 1) / motion.rate_hz) if len(outside) else 0.0,
    }


def turning(points: np.ndarray) -> dict[str, float]:
    """How far the lowest points (of (T, k, 3)) turn about the root's vertical at most [degrees], and how far outwards
    [mm], both their mean against the first frame."""
    across = _low(points).astype(np.float64) @ np.array([1.0, 1.0j, 0.0])
    twist = np.angle(across * across[0].conj()).mean(axis=1)
    outwards = (np.abs(across) - np.abs(across[0])).mean(axis=1)
    return {"twist_degrees": float(np.degrees(np.abs(twist).max())), "flare_mm": 1000 * float(outwards.max())}


def hem_velocity(points: np.ndarray) -> np.ndarray:
    """(T - 1, l, 3) [m a frame] of the l lowest points (of (T, k, 3))."""
    return np.diff(_low(points).astype(np.float64), axis=0)


def octaves(own: np.ndarray, simulated: np.ndarray, rate_hz: float) -> dict[str, float]:
    """How much a signal (T, ...) goes to and fro in each octave from 0.5 to 8 Hz, over what the simulated one does:
    ratios of root mean squares, by the lower end of the octave [Hz]."""
    frequency = np.fft.rfftfreq(len(own), 1 / rate_hz)

    def power(signal: np.ndarray) -> np.ndarray:
        flat = signal.reshape(len(signal), -1)
        window = np.hanning(len(flat))[:, None]
        return (np.abs(np.fft.rfft((flat - flat.mean(axis=0)) * window, axis=0)) ** 2).sum(axis=1)

    ours, theirs = power(own), power(simulated)
    bands = [(frequency >= low) & (frequency < high) for low, high in zip(OCTAVES, OCTAVES[1:])]
    return {f"{low:g}": float(np.sqrt(ours[band].sum() / theirs[band].sum())) for low, band in zip(OCTAVES, bands)}


def _low(points: np.ndarray) -> np.ndarray:
    order = np.argsort(points[0, :, 2])
    return points[:, order[: max(1, round(LOWEST * points.shape[1]))]]
