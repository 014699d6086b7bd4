"""Compiled loops of joint boosting: sums of all splits, the greedy search for the sharing set, scores.

Arrays in, arrays out; nothing is checked here. Everything is added up in one fixed order, so that the
numbers do not depend on how many threads there are.
"""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

BLOCK = 512  # splits whose gains are held at once; they stay in the nearest cache
LIGHTEST = (
    1e-140  # share of all weight below which a side counts as empty: a product of two is still a number
)


@_jit
def sums_below(code, n_bins, has_missing, used, weight, signed, below_weight, below_signed):
    """Fill (C, K) arrays with the sums, per class and split, over the samples that lie below it.

    ``code`` (F, n) holds each sample's bin, ``n_bins[f]`` for a missing value. ``used`` lists the features to
    take; the splits of a feature are its bins but the last, with missing values below, and then, if it has
    any, the same again with missing values above. Returns K, the number of splits filled.
    """
    n, n_classes = weight.shape
    largest = 1
    for f in used:
        largest = max(largest, n_bins[f] + 1)
    bin_weight = np.empty((largest, n_classes))
    bin_signed = np.empty((largest, n_classes))
    k = 0
    for f in used:
        b = n_bins[f]
        bin_weight[: b + 1] = 0.0
        bin_signed[: b + 1] = 0.0
        for i in range(n):
            at = code[f, i]
            for c in range(n_classes):
                bin_weight[at, c] += weight[i, c]
                bin_signed[at, c] += signed[i, c]
        for c in range(n_classes):
            sum_weight = bin_weight[b, c]
            sum_signed = bin_signed[b, c]
            for t in range(b - 1):
                sum_weight += bin_weight[t, c]
                sum_signed += bin_signed[t, c]
                below_weight[c, k + t] = sum_weight
                below_signed[c, k + t] = sum_signed
        k += b - 1
        if not has_missing[f]:
            continue
        for c in range(n_classes):
            sum_weight = 0.0
            sum_signed = 0.0
            for t in range(b - 1):
                sum_weight += bin_weight[t, c]
                sum_signed += bin_signed[t, c]
                below_weight[c, k + t] = sum_weight
                below_signed[c, k + t] = sum_signed
        k += b - 1
    return k


@_jit
def best_split(own_weight, own_signed, set_weight, set_signed, total_weight, total_signed, lightest, tie):
    """Return (gain, split) of the best split for a set of classes and one more; (-1, -1) if there is none.

    The set's sums and the class' own are added. The gain is what the two sides' means take off the sum of
    squares. A split counts as better only if it is so by more than ``tie``: the first of equals is taken.
    """
    gain = np.empty(BLOCK)
    best = -1.0
    best_at = -1
    for start in range(0, own_weight.size, BLOCK):
        stop = min(start + BLOCK, own_weight.size)
        one_weight, one_signed = own_weight[start:stop], own_signed[start:stop]
        all_weight, all_signed = set_weight[start:stop], set_signed[start:stop]
        for j in range(stop - start):  # without a branch, so that several are done at once
            w_below = one_weight[j] + all_weight[j]
            z_below = one_signed[j] + all_signed[j]
            w_above = total_weight - w_below
            z_above = total_signed - z_below
            two_sided = (w_below > lightest) & (w_above > lightest)
            divisor = w_below * w_above if two_sided else 1.0
            both = (z_below * z_below * w_above + z_above * z_above * w_below) / divisor
            gain[j] = both if two_sided else -1.0
        highest = -1.0
        for j in range(stop - start):
            highest = gain[j] if gain[j] > highest else highest
        if highest <= best + tie:
            continue
        for j in range(stop - start):
            if gain[j] > best + tie:
                best = gain[j]
                best_at = start + j
    return best, best_at


@_jit
def search(
    below_weight, below_signed, total_weight, total_signed, most_shared, side_share, tie_share, shared
):
    """Greedy forward search for the sharing set; fills ``shared`` (C,) and returns (gain, split).

    The set begins with the best class alone; then the class is added that leaves the least error, until all
    (or ``most_shared``) are in; of the nested sets the best is taken. ``gain`` is the reduction of the
    weighted squared error against constants alone; the split is -1 if no split has two sides.
    """
    n_classes, n_splits = below_weight.shape
    constant = np.zeros(n_classes)
    everything = 0.0
    for c in range(n_classes):
        if total_weight[c] > 0.0:
            constant[c] = total_signed[c] * total_signed[c] / total_weight[c]
        everything += total_weight[c]
    tie = tie_share * everything
    set_weight = np.zeros(n_splits)
    set_signed = np.zeros(n_splits)
    order = np.full(n_classes, -1, np.int64)
    is_in = np.zeros(n_classes, np.bool_)
    w = 0.0
    z = 0.0
    replaced = 0.0  # what the constants of the set's classes would have gained
    best_gain = -1.0
    best_at = -1
    best_size = 0
    for size in range(1, most_shared + 1):
        step_gain = -np.inf
        step_at = -1
        step_class = -1
        for c in range(n_classes):
            if is_in[c]:
                continue
            both = w + total_weight[c]
            gain, at = best_split(
                below_weight[c],
                below_signed[c],
                set_weight,
                set_signed,
                both,
                z + total_signed[c],
                max(side_share * both, LIGHTEST),
                tie,
            )
            if at >= 0 and gain - replaced - constant[c] > step_gain + tie:
                step_gain = gain - replaced - constant[c]
                step_at = at
                step_class = c
        if step_class < 0:
            break
        order[size - 1] = step_class
        is_in[step_class] = True
        w += total_weight[step_class]
        z += total_signed[step_class]
        replaced += constant[step_class]
        for k in range(n_splits):
            set_weight[k] += below_weight[step_class, k]
            set_signed[k] += below_signed[step_class, k]
        if step_gain > best_gain + tie:
            best_gain = step_gain
            best_at = step_at
            best_size = size
    shared[:] = False
    for j in range(best_size):
        shared[order[j]] = True
    return best_gain, best_at


@_jit
def add_scores(x, feature, threshold, missing_above, above, below, shared, constant, score):
    """Add the stumps' values for samples (n, F) to ``score`` (n, C), one stump after the other."""
    n, n_classes = score.shape
    for i in range(n):
        for m in range(feature.size):
            v = x[i, feature[m]]
            is_above = missing_above[m] if np.isnan(v) else v > threshold[m]
            value = above[m] if is_above else below[m]
            for c in range(n_classes):
                score[i, c] += value if shared[m, c] else constant[m, c]
