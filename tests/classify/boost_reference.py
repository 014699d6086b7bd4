"""Slow, obvious joint boosting."""

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


def search_slowly(x, sign, weight):
    """The greedy search: (error, split, sharing set) of the best of the nested sets."""
    shared = np.zeros(sign.shape[1], bool)
    nested = []
    while not shared.all():
        candidates = []
        for c in np.flatnonzero(~shared):
            bigger = shared.copy()
            bigger[c] = True
            candidates.append(bigger)
        nested.append(best_of(x, sign, weight, candidates))
        shared = np.array(nested[-1][2])
    return min(nested)


def boost_slowly(x, label, n_rounds):
    """Yield (error, split, sharing set) of every round of joint boosting."""
    n_classes = label.max() + 1
    sign = np.where(label[:, None] == np.arange(n_classes), 1.0, -1.0)
    share = (sign > 0).mean(axis=0)
    score = np.tile(0.5 * np.log(share / (1 - share)), (len(x), 1))
    for _ in range(n_rounds):
        best = search_slowly(x, sign, np.exp(-sign * score))
        score += error_of(x, sign, np.exp(-sign * score), (*best[1], np.array(best[2])))[1]
        yield best


def accuracy(scores, y):
    return float(np.mean(two_sided(scores).argmax(axis=1) == y))
