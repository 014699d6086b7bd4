"""Made-up problems of classification on which the truth is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["coded", "mixed", "projected"]

Problem = tuple[NDArray[np.float64], NDArray[np.int64]]


def coded(
    n_classes: int,
    n_per_class: int,
    seed: int,
    *,
    n_bits: int = 10,
    noise: float = 0.35,
    n_useless: int = 10,
) -> Problem:
    """Classes that differ by a code of noisy bits, half of them set; and features that say nothing."""
    fixed = np.random.default_rng(7)
    half = np.repeat([1.0, -1.0], n_bits // 2)
    code = np.array([fixed.permutation(half) for _ in range(n_classes)])
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    bits = code[y] + noise * rng.normal(size=(y.size, n_bits))
    return np.column_stack([bits, rng.normal(size=(y.size, n_useless))]), y


def projected(n_classes: int, n_per_class: int, seed: int, *, n_directions: int = 40) -> Problem:
    """Discs on a square grid, seen as their coordinates along many directions."""
    angle = np.pi * np.arange(n_directions) / n_directions
    side = int(np.ceil(np.sqrt(n_classes)))
    centre = np.array([(i % side, i // side) for i in range(n_classes)], float)
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    place = centre[y] + 0.22 * rng.normal(size=(y.size, 2))
    return place @ np.array([np.cos(angle), np.sin(angle)]), y


def mixed(
    n_per_class: int,
    n_classes: int = 6,
    n_features: int = 30,
    *,
    seed: int = 0,
    spread: float = 0.6,
    missing: float = 0.03,
    n_properties: int = 5,
) -> Problem:
    """Classes in a space of a few properties, of which the features are noisy mixtures, some crooked.

    ``spread`` is that of the properties within a class; the classes' own lie about 1 apart in each.
    """
    fixed = np.random.default_rng(123)
    middle = fixed.normal(size=(n_classes, n_properties))
    mix = fixed.normal(size=(n_properties, n_features))
    mix *= fixed.random((n_properties, n_features)) < 2.0 / n_properties
    noise = fixed.uniform(0.3, 1.5, n_features)
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    x = (middle[y] + spread * rng.normal(size=(y.size, n_properties))) @ mix
    x += noise * rng.normal(size=x.shape)
    x[:, ::3] = np.exp(x[:, ::3] / 3.0)
    x[rng.random(x.shape) < missing] = np.nan
    return x, y
