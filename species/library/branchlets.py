"""Branchlets of a species, and the patches into which they are cut.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 3.4 and figure 3.5 (an L-system forms 20 to 30 complete branchlets of different
thickness, shape and orientation; they are partitioned, and docking points say where smaller twigs go on).
Departs from it in: of the side twigs that are cut off only some are kept as patches, for they are much alike.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from species.errors import DerivationError, GrammarError
from species.foliage import LeafSet
from species.library.definition import Definition
from species.patches import Patch
from treegraph import NO_PARENT, TreeGraph, take_nodes

if TYPE_CHECKING:
    from species.lsystem import Grammar

__all__ = ["Branchlet", "cut_branchlet", "derive_branchlets", "leaf_box"]

GOLDEN = 0.6180339887498949
MOST_NODES, MOST_LEAVES = 4000, 1500  # of one branchlet
LEAST_RADIUS, MOST_RADIUS = 2e-4, 1.0  # metres
LEAST_LEAF, MOST_LEAF = 1e-4, 10.0  # metres
MOST_REACH = 100.0  # metres from the foot
MOST_MODULES = 200_000  # of a branchlet's word
MOST_SECONDS = 30.0  # for all branchlets
WHOLE_LEAVES = 16  # a twig of so many leaves or fewer is not cut
CUT_LEAVES = 5  # a side twig of so many leaves or more is cut off
KEPT = (2, 1)  # side twigs that become patches: of a branchlet, and of such a side twig
ORDER_STREAM = 7  # of the random numbers that put leaves in order
PLACE = re.compile(r"line (\d+), column \d+")
LIMITS_HINT = re.compile(r",? or for more[^;]* with DerivationLimits\([^)]*\)")  # nothing that a file can say


@dataclass(frozen=True, eq=False)
class Branchlet:
    """A whole twig as it hangs on the tree: its foot at the origin, z up, setting off towards +y.

    Attributes
    ----------
    graph : TreeGraph
        Metres; attribute ``order``: brackets of the grammar around each node.
    leaves : LeafSet
    size, slope_deg : float
        The parameters of the grammar.
    """

    graph: TreeGraph
    leaves: LeafSet
    size: float
    slope_deg: float

    def __repr__(self) -> str:
        return f"<Branchlet {self.graph.n_nodes} nodes, {self.leaves.n_leaves} leaves, size {self.size:.2f}>"


def leaf_box(definition: Definition) -> tuple[float, float]:
    """Length of a species' leaf (petiole's end to tip), and width of its texture's box, metres."""
    from species.leafart import leaf_frame

    left, _, right, _ = leaf_frame(definition.leaf)
    return definition.leaf.length, float(right - left)


def derive_branchlets(definition: Definition) -> tuple[Branchlet, ...]:
    """Derive a species' branchlets from its grammar.

    Sizes and slopes are spread evenly over their ranges, in orders that do not go together.

    Returns
    -------
    branchlets : tuple of Branchlet
        ``definition.branchlets.count`` of them; the same for the same definition.

    Raises
    ------
    GrammarError, DerivationError
        If the grammar is at fault, or a branchlet has no wood, no leaves, something out of its range, or too
        many nodes; or they take too long. The message has the branchlet, and line and column where there
        is a place.
    """
    rules = definition.branchlets
    with _about(definition, "grammar"):
        grammar = rules.parse()
        for name in ("size", "slope"):
            if name not in grammar.parameters:
                raise DerivationError(f"it must have `param {name} = ...`, which is set for each branchlet")
    length, width = leaf_box(definition)
    end = perf_counter() + MOST_SECONDS
    made = []
    for k in range(rules.count):
        share = 0.5 if rules.count == 1 else k / (rules.count - 1)
        size = rules.size[0] + (rules.size[1] - rules.size[0]) * share
        slope = rules.slope_deg[0] + (rules.slope_deg[1] - rules.slope_deg[0]) * ((k + 0.5) * GOLDEN % 1.0)
        with _about(definition, f"branchlet {k + 1} of {rules.count}"):
            if perf_counter() > end:
                raise DerivationError(
                    f"deriving all takes longer than {MOST_SECONDS:g} s; draw smaller twigs"
                )
            made.append(_derive(grammar, k, float(size), float(slope), width / length))
    return tuple(made)


def _derive(grammar: Grammar, k: int, size: float, slope: float, width_share: float) -> Branchlet:
    """The k-th branchlet."""
    from species.lsystem import DerivationLimits, derive_word, draw_word

    word = derive_word(
        grammar,
        rng=np.random.default_rng([k, 1]),
        parameters={"size": size, "slope": slope},
        limits=DerivationLimits(modules=MOST_MODULES),
    )
    drawing = draw_word(word)
    tree, found = drawing.tree, drawing.leaves
    keep = found.size > 0.0
    length = found.size[keep]
    leaves = LeafSet(
        found.base[keep],
        found.along[keep],
        found.normal[keep],
        length,
        length * width_share,
        found.node[keep],
    )
    _check_branchlet(tree, leaves)
    graph = tree.replace(radius=np.maximum(tree.radius, LEAST_RADIUS))
    return Branchlet(graph, leaves, size, slope)


def _check_branchlet(tree: TreeGraph, leaves: LeafSet) -> None:
    if tree.n_nodes < 2:
        raise DerivationError("it has no wood: its word draws no F")
    if (tree.parent[1:] == NO_PARENT).any() or tree.position[0].any():
        raise DerivationError("it is in pieces: f moves without drawing, and leaves a gap")
    if not leaves.n_leaves:
        raise DerivationError("it has no leaves: its word places no L with a size above 0")
    if tree.n_nodes > MOST_NODES or leaves.n_leaves > MOST_LEAVES:
        raise DerivationError(
            f"it has {tree.n_nodes} nodes and {leaves.n_leaves} leaves; at most {MOST_NODES} and "
            f"{MOST_LEAVES} are taken: draw a smaller twig, larger ones are put together of them"
        )
    reach = float(np.abs(np.concatenate([tree.position, leaves.base])).max())
    ranges = (
        ("its leaves must be", leaves.length, LEAST_LEAF, MOST_LEAF, "long"),
        ("its wood must be", tree.radius, 0.0, MOST_RADIUS, "thick, as radius"),
        ("it must reach", np.array([reach]), 1e-3, MOST_REACH, "far"),
    )
    for what, value, low, high, which in ranges:
        wrong = value[(value < low) | (value > high)]
        if len(wrong):
            raise DerivationError(f"{what} from {low:g} to {high:g} m {which}, got {wrong[0]:.6g} m")


@contextmanager
def _about(definition: Definition, what: str) -> Iterator[None]:
    """Say of an error in which branchlet it is, and on which line of the species' file."""
    try:
        yield
    except (GrammarError, DerivationError) as error:
        text = LIMITS_HINT.sub("", str(error))
        place = PLACE.match(text)
        before = definition.text.find(definition.branchlets.grammar)  # -1: it is written with escapes
        if place is not None and before >= 0:
            line = definition.text.count("\n", 0, before) + int(place[1])
            text = f"{place[0]} (line {line} of the file){text[place.end() :]}"
        text = f"[branchlets] {what}{', ' if place else ': '}{text}"
        if isinstance(error, GrammarError):
            raise GrammarError(text, error.line, error.column) from None
        raise DerivationError(text) from None


def cut_branchlet(branchlet: Branchlet, number: int = 0) -> list[Patch]:
    """Cut a branchlet into patches with docking points.

    Side twigs with several leaves are cut off and leave a docking point: where they stood, in which direction
    they set off, how thick they were. Some of them, of different size, become patches themselves, cut in
    the same way once more. What has few leaves stays whole, has no docking points, and ends texturing.

    Parameters
    ----------
    branchlet : Branchlet
    number : int
        Its number, for :attr:`species.patches.Patch.branchlet` and for the order of leaves.

    Returns
    -------
    patches : list of Patch
        The first holds the branchlet's root.
    """
    rng = np.random.default_rng([number, ORDER_STREAM])
    return _cut(branchlet.graph, branchlet.leaves, KEPT, number, rng)


def _cut(
    graph: TreeGraph, leaves: LeafSet, kept: tuple[int, ...], number: int, rng: np.random.Generator
) -> list[Patch]:
    """Patches of the tree that hangs on node 0, which is its root."""
    carried = _carried_leaves(graph, leaves.node)
    twigs = np.empty(0, np.int64)
    if kept and leaves.n_leaves > WHOLE_LEAVES:
        twigs = _side_twigs(graph, carried)
    gone = np.zeros(graph.n_nodes, bool)
    gone[twigs] = True
    for i in range(1, graph.n_nodes):
        gone[i] |= gone[graph.parent[i]]
    out = [_patch(graph, leaves, ~gone, twigs, number, rng)]
    if len(twigs):
        by_size = twigs[np.argsort(-carried[twigs], kind="stable")]
        pick = np.unique(np.linspace(0, len(by_size) - 1, min(kept[0], len(by_size))).round().astype(int))
        for node in by_size[pick]:
            twig, its_leaves = _twig(graph, leaves, int(node))
            out += _cut(twig, its_leaves, kept[1:], number, rng)
    return out


def _carried_leaves(graph: TreeGraph, node: NDArray[np.int32]) -> NDArray[np.int64]:
    """Leaves on each node and all beyond it."""
    carried = np.bincount(node, minlength=graph.n_nodes)
    for i in range(graph.n_nodes - 1, 0, -1):
        carried[graph.parent[i]] += carried[i]
    return carried


def _side_twigs(graph: TreeGraph, carried: NDArray[np.int64]) -> NDArray[np.int64]:
    """First nodes of the side twigs of the axis that are cut off: a bracket deeper than where they stand."""
    order = graph.attribute["order"].copy()
    order[0] = order[1:].min()  # a root counts as part of its axis
    axis = np.zeros(graph.n_nodes, bool)
    axis[0] = True
    twigs = []
    for i in range(1, graph.n_nodes):
        above = graph.parent[i]
        if not axis[above]:
            continue
        if order[i] > order[above] and carried[i] >= CUT_LEAVES:
            twigs.append(i)
        else:
            axis[i] = True
    return np.array(twigs, np.int64)


def _twig(graph: TreeGraph, leaves: LeafSet, node: int) -> tuple[TreeGraph, LeafSet]:
    """The side twig that begins at a node, with the node that it stands on as its root."""
    mine = np.zeros(graph.n_nodes, bool)
    mine[node] = True
    for i in range(node + 1, graph.n_nodes):
        mine[i] = mine[graph.parent[i]]
    root = int(graph.parent[node])
    keep = mine.copy()
    keep[root] = True
    number = np.cumsum(keep) - 1
    twig = take_nodes(graph, np.flatnonzero(keep))
    radius = twig.radius.copy()
    radius[0] = graph.radius[node]
    return twig.replace(radius=radius), _take_leaves(leaves, mine[leaves.node], number)


def _take_leaves(leaves: LeafSet, keep: NDArray[np.bool_], number: NDArray[np.int64]) -> LeafSet:
    return LeafSet(
        leaves.base[keep], leaves.along[keep], leaves.normal[keep], leaves.length[keep], leaves.width[keep],
        number[leaves.node[keep]].astype(np.int32),
    )  # fmt: skip


def _patch(
    graph: TreeGraph,
    leaves: LeafSet,
    keep: NDArray[np.bool_],
    twigs: NDArray[np.int64],
    number: int,
    rng: np.random.Generator,
) -> Patch:
    """What is left of a twig, in a patch's frame, with docking points where side twigs were."""
    node = np.flatnonzero(keep)
    wood = take_nodes(graph, node)
    root = wood.position[0]
    axis = _first_way(wood) if wood.n_nodes > 1 else _unit(graph.position[twigs[0]] - root)
    turn = _frame(axis)
    its = _take_leaves(leaves, keep[leaves.node], np.cumsum(keep) - 1)
    order = rng.permutation(its.n_leaves)
    foot = graph.position[graph.parent[twigs]]
    return Patch(
        TreeGraph(wood.parent, (wood.position - root) @ turn, wood.radius),
        LeafSet(
            ((its.base - root) @ turn)[order], (its.along @ turn)[order], (its.normal @ turn)[order],
            its.length[order], its.width[order], its.node[order],
        ),
        (foot - root) @ turn,
        _unit(graph.position[twigs] - foot) @ turn,
        graph.radius[twigs],
        float(wood.radius[0]),
        float(np.arcsin(np.clip(axis[2], -1.0, 1.0))),
        number,
    )  # fmt: skip


def _first_way(wood: TreeGraph) -> NDArray[np.float64]:
    """Direction in which a twig sets off: along its axis, to the first node that is somewhere else."""
    on_axis = np.flatnonzero(wood.attribute["order"] == wood.attribute["order"][1:].min())
    away = wood.position - wood.position[0]
    far = np.linalg.norm(away, axis=1) > 1e-9
    first = next((i for i in (*on_axis, *range(wood.n_nodes)) if far[i]), 0)
    return _unit(away[first])


def _frame(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrix whose columns are a patch's x (the side that looks up), y and z (the axis)."""
    up = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    if np.linalg.norm(up) < 1e-6:
        up = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    x = up / np.linalg.norm(up)
    return np.column_stack([x, np.cross(axis, x), axis])


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > 1e-12, vector / np.maximum(length, 1e-12), (0.0, 0.0, 1.0))
