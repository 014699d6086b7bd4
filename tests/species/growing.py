"""What the tests of growth share: plain parameters, the model's insides by hand, statistics."""

from types import SimpleNamespace

import numpy as np

from species import GrowthParameters, GrowthSettings, Plant, Site, find_preset, grow
from species import _growth_kernels as kernels
from species import growth as model
from species.parameters import parameter_table

#: Every bud flushes, nothing dies, bends, is shed or turns: what a test wants it sets.
PLAIN = {
    "AAV": 0, "NLB": 2, "BAM": 45, "BAV": 0, "RAM": 90, "RAV": 0,
    "AB_D": 0, "LB_D": 0, "LF_A": 0, "LF_L": 0, "AD_BF": 0, "AD_DF": 0.5, "AD_AF": 1,
    "GR": 1, "IBL": 0.5, "IL_AF": 1, "AC": 1, "AC_AF": 1, "PT": 0, "GT": 0,
    "PF": 0, "LB_PF": 0, "GBS": 0, "GBA": 0,
}  # fmt: skip

FREE = GrowthSettings(ground=False, foliage=0.0)
"""No ground, no leaves: every light is 1."""


def plain(**changes):
    return GrowthParameters.from_symbols(PLAIN | changes)


def preset(name, **changes):
    return find_preset(name).parameters.replace(**changes)


def seeded(seed):
    return np.random.default_rng(seed)


def grown(parameters, age, seed=0, **more):
    return grow(parameters, age, rng=seeded(seed), **more)


def same_bytes(one, two):
    """Whether two trees are the same to the bit, attributes that both have included."""
    names = one.attribute.keys() & two.attribute.keys()
    pairs = [(one.parent, two.parent), (one.position, two.position), (one.radius, two.radius)]
    pairs += [(one.attribute[name], two.attribute[name]) for name in names]
    return all(a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in pairs)


def steps(tree):
    """Segments (n - 1, 3), of nodes 1, 2, ..., of a tree with one root."""
    return tree.position[1:] - tree.position[tree.parent[1:]]


def directions(tree):
    """Unit vectors (n, 3) of the segments; up at the root."""
    step = np.vstack([(0.0, 0.0, 1.0), steps(tree)])
    return step / np.linalg.norm(step, axis=1, keepdims=True)


def random_parameters(rng):
    """A vector somewhere in the legal ranges: uniform, or uniform in the logarithm where it can be."""
    values = {}
    for row in parameter_table():
        low, high = row["low"], row["high"]
        if row["integer"]:
            values[row["symbol"]] = int(rng.integers(low, high + 1))
            continue
        value = rng.uniform(low, high)
        if low >= 0 and rng.random() < 0.5:
            floor = max(low, 1e-3 * high)
            value = min(high, floor * (high / floor) ** rng.random())
        values[row["symbol"]] = float(value)
    return GrowthParameters.from_symbols(values)


def lively_parameters(rng):
    """A vector that nearly always grows into something, but not into too much."""
    values = random_parameters(rng).symbols()
    values |= {"NLB": int(rng.integers(0, 4)), "GR": rng.uniform(0.5, 3.0), "IBL": rng.uniform(0.1, 1.0)}
    values |= {"IL_AF": rng.uniform(0.85, 1.0), "AD_BF": rng.uniform() ** 3 * 10.0}
    for symbol, share in {
        "AB_D": 0.1, "LB_D": 0.3, "LF_A": 0.1, "LF_L": 0.2, "PF": 0.1, "LB_PF": 0.03, "PT": 0.3, "GT": 0.3,
    }.items():  # fmt: skip
        values[symbol] *= share
    return GrowthParameters.from_symbols(values)


# ---------------------------------------------------------------- the insides


def insides(parameters, age, seed=0, settings=None, site=None):
    """The compiled model's state after so many cycles: nodes, n, stand."""
    plants, settings, site = [Plant(parameters)], settings or GrowthSettings(), site or Site()
    stand, meshes = model._make_stand(plants, site, settings, False)
    drawn = int(seeded(seed).integers(2**63))
    nodes = model._seedlings(plants, 1 + parameters.n_lateral_buds, drawn, stand, False)
    nodes, n, _, _ = model._run(nodes, 1, stand, meshes, settings, age)
    return SimpleNamespace(nodes=nodes, n=n, stand=stand)


def by_hand(parameters, parent, direction, length, *, birth=0, order=None, settings=None):
    """The same of a tree that is laid out by hand; ``direction[i]`` and ``length[i]`` are of segment i."""
    state = insides(parameters, 0, settings=settings)
    nodes, n = state.nodes, len(parent)
    direction = np.asarray(direction, float)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    nodes.parent[:n] = parent
    nodes.birth[:n] = birth
    nodes.death[:n] = kernels.ALIVE
    nodes.direction[:n], nodes.length[:n] = direction, length
    nodes.order[:n] = 0 if order is None else order
    nodes.light[:n] = 1.0
    nodes.buds[:n] = kernels.DORMANT
    nodes.buds[0, 1:] = kernels.NONE
    for i in range(n):
        nodes.key[i] = kernels.child_key(np.uint64(i), 0)
        nodes.side[i] = kernels.side_of(np.array((1.0, 0.2, 0.1)), nodes.direction[i])
        if i:
            nodes.position[i] = nodes.position[parent[i]] + length[i] * direction[i]
    nodes.length[0] = 0.0
    state.n = n
    return state


def random_shape(rng, n):
    """Parents of a random tree, each before its children."""
    return np.array([-1] + [int(rng.integers(max(0, i - 6), i)) for i in range(1, n)])
