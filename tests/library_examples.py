"""A small species and branchlets made by hand: what the tests of the library share."""

import numpy as np

from species.foliage import LeafSet
from species.library import Branchlet, build_species, building, open_species, parse_definition
from treegraph import TreeGraph

GRAMMAR = """\
param size = 1
param slope = 30
iterations = 8
axiom = &(90 - slope) A(4, 0.004 + 0.004 * size)
A(n, w) : n > 0 -> !(w) F(0.12 * size) [ +(50) B(3, w * 0.6) ] [ -(50) B(3, w * 0.6) ] /(90) A(n - 1, w * 0.8)
A(n, w) -> L(0.08)
B(n, w) : n > 0 -> !(w) F(0.05) [ +(40) L(0.06) ] [ -(40) L(0.07) ] B(n - 1, w * 0.8)
B(n, w) -> L(0.05)
"""

GROWTH = {
    "age": 12, "AAV": 60, "NLB": 2, "BAM": 55, "BAV": 60, "RAM": 80, "RAV": 400, "AB_D": 0, "LB_D": 0.25,
    "LF_A": 0.36, "LF_L": 1.05, "AD_BF": 0.38, "AD_DF": 0.31, "AD_AF": 0.9, "GR": 1.9, "IBL": 0.54,
    "IL_AF": 0.98, "AC": 0.25, "AC_AF": 0.7, "PT": 0.15, "GT": 0.03, "PF": 1, "LB_PF": 2.9, "GBS": 0.19,
    "GBA": 0.14,
}  # fmt: skip

ROWAN = {
    "name": "Rowan",
    "latin": "Sorbus aucuparia",
    "also": ["mountain ash"],
    "what": "A small tree.",
    "leaf_area_density": 2.5,
    "allometry": {"beta": 1.6, "gamma": 1.5, "f_s": 0.98},
    "branchlets": {"count": 4, "size": [0.5, 1.0], "slope_deg": [0, 60], "grammar": GRAMMAR},
    "leaf": {"kind": "simple", "length": 0.08, "width": 0.04},
    "leaf_colors": {"summer": [70, 108, 44]},
    "bark": {"kind": "smooth"},
    "growth": GROWTH,
}
"""A species. Its branchlets have an axis of 4 internodes with a leaf at its end, and two side twigs on each,
of 3 internodes and 7 leaves: 29 nodes and 57 leaves.
"""


def species_text(drop=(), **changes):
    """The file of a small species; `changes` replace entries, of tables as ``allometry__beta=2``."""
    table = {key: dict(value) if isinstance(value, dict) else value for key, value in ROWAN.items()}
    for key, value in changes.items():
        name, _, entry = key.partition("__")
        if entry:
            table.setdefault(name, {})[entry] = value
        else:
            table[name] = value
    for key in (drop,) if isinstance(drop, str) else drop:
        name, _, entry = key.partition("__")
        if entry:
            del table[name][entry]
        else:
            del table[name]
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    lines = [f"{key} = {toml(value)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", f"[{key}]", *(f"{name} = {toml(entry)}" for name, entry in value.items())]
    return "\n".join(lines) + "\n"


def small_species(pixels=32, **changes):
    """That species, its pictures of 32 pixels, which are drawn at once."""
    definition = parse_definition(species_text(**changes))
    side, building.PICTURE_SIDE = building.PICTURE_SIDE, pixels
    try:
        return open_species(definition, build_species(definition))
    finally:
        building.PICTURE_SIDE = side


def toml(value):
    """A value as TOML has it; a grammar as a text of several lines, as people write it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        if value.count("\n") > 1 and value.isascii() and value.replace("\n", "").isprintable():
            return f"'''\n{value}'''"
        return (
            '"'
            + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
            + '"'
        )
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml(part) for part in value)}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(part)}" for key, part in value.items()) + "}"
    return repr(value)


def random_branchlet(seed=0, n_nodes=20, n_leaves=15, reach=0.5, width_share=0.5):
    """A random tree within `reach` of the origin with leaves anywhere near its nodes."""
    rng = np.random.default_rng(seed)
    parent = np.array([-1] + [int(rng.integers(0, i)) for i in range(1, n_nodes)], np.int32)
    position = rng.uniform(-reach, reach, (n_nodes, 3))
    position[0] = 0.0
    order = np.zeros(n_nodes, np.int32)
    for i in range(1, n_nodes):
        order[i] = order[parent[i]] + rng.integers(0, 2)
    graph = TreeGraph(parent, position, 10.0 ** rng.uniform(-3.6, -1.0, n_nodes), {"order": order})
    node = rng.integers(0, n_nodes, n_leaves).astype(np.int32)
    along = unit(rng.normal(size=(n_leaves, 3)))
    normal = unit(np.cross(along, rng.normal(size=(n_leaves, 3))))
    length = 10.0 ** rng.uniform(-3.0, 0.5, n_leaves)
    base = position[node] + rng.uniform(-0.02, 0.02, (n_leaves, 3))
    leaves = LeafSet(base, along, normal, length, width_share * length, node)
    return Branchlet(graph, leaves, float(rng.uniform(0.1, 2.0)), float(rng.uniform(-90, 90)))


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
