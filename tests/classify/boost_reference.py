"""Slow, obvious joint boosting, and problems on which sharing can be measured."""

from itertools import pairwise

import numpy as np

from classify.stumps import two_sided


def error_of(x, sign, weight, stump):
    """Weighted squared error of one stump, by its definition; and its values for the classes."""
    feature, threshold, missing_above, shared = stump
    value = x[:, feature]
    above = np.where(np.isnan(value), missing_above, value > threshold)
    h = np.empty_like(sign)
    for c in range(sign.shape[1]):
        if not shared[c]:
            h[:, c] = np.sum(weight[:, c] * sign[:, c]) / np.sum(weight[:, c])
    for side in (above, ~above):
        if side.any() and any(shared):
            w = weight[side][:, shared]
            h[np.ix_(side, shared)] = np.sum(w * sign[side][:, shared]) / np.sum(w)
    return np.sum(weight * (sign - h) ** 2), h


def splits_of(x):
    """Every (feature, threshold, side of missing values)."""
    for feature in range(x.shape[1]):
        known = np.unique(x[~np.isnan(x[:, feature]), feature])
        has_missing = np.isnan(x[:, feature]).any()
        for side in (False, True) if has_missing else (False,):
            for low, high in pairwise(known):
                yield feature, 0.5 * low + 0.5 * high, side


def best_of(x, sign, weight, sets):
    """Least (error, stump) over the given sharing sets and all splits."""
    return min(
        (error_of(x, sign, weight, (*split, shared))[0], split, tuple(shared))
        for shared in sets
        for split in splits_of(x)
    )


def boost_slowly(x, label, n_rounds):
    """Yield (error, split, sharing set) of every round of joint boosting with the greedy search."""
    n_classes = label.max() + 1
    sign = np.where(label[:, None] == np.arange(n_classes), 1.0, -1.0)
    share = (sign > 0).mean(axis=0)
    score = np.tile(0.5 * np.log(share / (1 - share)), (len(x), 1))
    for _ in range(n_rounds):
        weight = np.exp(-sign * score)
        shared = np.zeros(n_classes, bool)
        nested = []
        while not shared.all():
            candidates = []
            for c in np.flatnonzero(~shared):
                bigger = shared.copy()
                bigger[c] = True
                candidates.append(bigger)
            nested.append(best_of(x, sign, weight, candidates))
            shared = np.array(nested[-1][2])
        best = min(nested)
        score += error_of(x, sign, weight, (*best[1], np.array(best[2])))[1]
        yield best


def coded(n_classes, n_per_class, seed, n_bits=10, noise=0.35, n_useless=10):
    """Classes that differ by a code of bits, which are noisy; and features that say nothing."""
    code_rng = np.random.default_rng(7)
    half = np.repeat([1.0, -1.0], n_bits // 2)
    code = np.array([code_rng.permutation(half) for _ in range(n_classes)])
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    bits = code[y] + noise * rng.normal(size=(y.size, n_bits))
    return np.column_stack([bits, rng.normal(size=(y.size, n_useless))]), y


def projected(n_classes, n_per_class, seed, n_directions=40):
    """Discs on a square grid, seen as their coordinates along many directions."""
    angle = np.pi * np.arange(n_directions) / n_directions
    side = int(np.ceil(np.sqrt(n_classes)))
    centre = np.array([(i % side, i // side) for i in range(n_classes)], float)
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    place = centre[y] + 0.22 * rng.normal(size=(y.size, 2))
    return place @ np.array([np.cos(angle), np.sin(angle)]), y


def mixed(n_per_class, n_classes=6, n_features=30, seed=0, spread=0.6, missing=0.03):
    """Classes in a space of a few properties, of which the features are mixtures, some crooked."""
    fixed = np.random.default_rng(123)
    middle = fixed.normal(size=(n_classes, 5))
    mix = fixed.normal(size=(5, n_features)) * (fixed.random((5, n_features)) < 0.4)
    noise = fixed.uniform(0.3, 1.5, n_features)
    rng = np.random.default_rng(seed)
    y = np.repeat(np.arange(n_classes), n_per_class)
    x = (middle[y] + spread * rng.normal(size=(y.size, 5))) @ mix
    x += noise * rng.normal(size=x.shape)
    x[:, ::3] = np.exp(x[:, ::3] / 3.0)
    x[rng.random(x.shape) < missing] = np.nan
    return x, y


def accuracy(scores, y):
    return float(np.mean(two_sided(scores).argmax(axis=1) == y))
