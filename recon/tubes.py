"""Tubes: where the axes of branches run and how thick they are, from the points around them.

Circles across the axis find trunk and branches that were seen around enough of their girth; a
least-squares fit of chains of frusta to all points then sets axis and radius together.

Based on: the circle and frustum fits are plain Gauss-Newton with Tukey weights; the idea that a
scanned branch is a chain of cylinders fitted to points is that of Raumonen et al., "Fast automatic
precision tree models from terrestrial laser scanner data", Remote Sensing 5(2), 2013.

Departs from it in: neighbouring frusta share their ends, so the surface has no steps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.skeleton import Skeleton, chains_of, merge_nodes, reorder

COARSE = 0.7  # distance of the nodes on a tube, in radii
AXIS_SLICES = 2.0  # direction of the axis: this many slices either way ...
AXIS_EXTENTS = 1.5  # ... or this many radii
CIRCLE_POINTS = 150  # a circle looks at no more points than this
MIN_CIRCLE_POINTS = 12
MIN_CIRCLE_ARC = 0.4  # share of the round in which a circle must have points
MAX_CIRCLE_INSIDE = 0.08  # share of the points nearer to its centre than half its radius
MAX_CIRCLE_SCATTER = 0.25  # scale of its residuals, in radii
MEDIAN_WINDOW = 4  # circles are compared with the median of so many on either side
MEDIAN_TOLERANCE = 0.3
CHILD_SHARE = 1.0  # a side chain is at most this much as thick as its parent
TUBE_SLACK = 0.2  # a slice this far outside a tube, in radii, still belongs to it
RIM_REACH = 1.5  # a chain that ends within so many radii of its last circle may be the tube's rim
BRIDGE_REACH = 10.0  # centres between two circles no farther apart are put in line, in radii
REFINE_ROUNDS = 6
POLISH_ROUNDS = 8
FOOT_LOOK = 0.10  # the direction of a side chain is that of its first piece of this length, metres
FOOT_REACH = 3.0  # its foot may move so far along the parent, in radii of it
STIFFNESS = 4.0  # pull of a chain towards straightness, in points
RADIUS_STIFFNESS = 6.0
POLISH_STIFFNESS = 0.03
POLISH_RADIUS_STIFFNESS = 1.0
HOLD = 1.0  # pull of a node towards where it began, in points


def fit_circles(xyz: np.ndarray, skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Tubes of a skeleton from circles across its axes.

    Returns
    -------
    tube : (n,) float64
        Radius along the chains up to their last believable circle, nan elsewhere.
    centre : (n, 3) float64
        Centre of the circle where one was believed, the node's position elsewhere.
    arc : (n,) float64
        Share of the round with points.
    extent : (n,) float64
        Mean distance of each node's points from the line through it, metres.
    """
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    up = np.tile(np.array([0.0, 0.0, 1.0]), (skeleton.n_nodes, 1))
    groups = (xyz, chains.point_start, chains.point, skeleton.position)
    reach = np.maximum(
        AXIS_SLICES * skeleton.slice_width, AXIS_EXTENTS * tubes.mean_axis_distance(*groups, up)
    )
    axis = tubes.axis_directions(skeleton.position, skeleton.parent, chains.onward, reach)
    extent = tubes.mean_axis_distance(*groups, axis)
    centre, radius, scatter, arc, used, inside = tubes.circle_fits(
        *groups, skeleton.parent, chains.onward, axis, MIN_CIRCLE_POINTS, CIRCLE_POINTS
    )
    with np.errstate(invalid="ignore"):
        accepted = (
            (radius <= skeleton.thickest)
            & (inside <= MAX_CIRCLE_INSIDE)
            & (used >= MIN_CIRCLE_POINTS)
            & (arc >= MIN_CIRCLE_ARC)
            & (scatter < MAX_CIRCLE_SCATTER * radius)
        )
    accepted = tubes.believable_circles(
        chains.head, chains.onward, radius, accepted, MEDIAN_WINDOW, MEDIAN_TOLERANCE
    )
    weight = np.minimum(used, CIRCLE_POINTS) * arc
    tube = tubes.chain_radii(
        chains.head, skeleton.parent, chains.onward, radius, accepted, weight, CHILD_SHARE
    )
    centre = np.where(accepted[:, None], centre, skeleton.position)
    centre = tubes.bridge_centres(
        chains.head, chains.onward, skeleton.position, centre, accepted, tube, BRIDGE_REACH
    )
    return tube, centre, np.where(accepted, arc, 0.0), extent


def absorb(skeleton: Skeleton, tube: np.ndarray, centre: np.ndarray, extent: np.ndarray) -> Skeleton:
    """Give the pieces of bark that lie on a tube to that tube."""
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    into = tubes.absorb_into_tubes(skeleton.parent, chains.onward, centre, tube, extent, TUBE_SLACK)
    tubes.absorb_rims(chains.head, skeleton.parent, chains.onward, centre, tube, into, RIM_REACH, TUBE_SLACK)
    return merge_nodes(skeleton, into)


def coarsen(skeleton: Skeleton, tube: np.ndarray, apart: np.ndarray | None = None) -> Skeleton:
    """Thin out the nodes on thick tubes: an axis shorter than its radius has no direction."""
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    apart = np.zeros(skeleton.n_nodes) if apart is None else apart
    into = tubes.coarsen(skeleton.parent, chains.onward, chains.head, skeleton.position, tube, COARSE, apart)
    return merge_nodes(skeleton, into)


def fit_tubes(xyz: np.ndarray, skeleton: Skeleton) -> Skeleton:
    """Put the nodes on the axes of their branches and give them a radius.

    Returns
    -------
    Skeleton
        The same nodes with `position`, `radius`, `is_tube` and `arc` set.
    """
    from recon import _skeleton_kernels as kernels
    from recon import _tube_kernels as tubes

    mean, _ = kernels.group_means(xyz, skeleton.label, skeleton.n_nodes)
    at_mean = replace(skeleton, position=mean)
    tube, centre, arc, extent = fit_circles(xyz, at_mean)
    is_tube = np.isfinite(tube)
    chains = chains_of(at_mean)
    radius = np.where(is_tube, tube, np.maximum(extent, 1e-3))
    position, radius, _ = tubes.refine_tubes(
        xyz,
        chains.point_start,
        chains.point,
        skeleton.parent,
        chains.onward,
        centre,
        radius,
        is_tube,
        centre,
        HOLD,
        REFINE_ROUNDS,
        STIFFNESS,
        RADIUS_STIFFNESS,
    )
    radius = np.minimum(radius, skeleton.thickest)
    return replace(skeleton, position=position, radius=radius, is_tube=is_tube, arc=arc)


def reattach(skeleton: Skeleton) -> Skeleton:
    """Let side chains leave their parent where they set off in their own direction."""
    from recon import _tube_kernels as tubes
    from treegraph import sort_topological

    chains = chains_of(skeleton)
    parent = tubes.forward_feet(
        skeleton.parent,
        chains.onward,
        chains.head,
        skeleton.position,
        skeleton.radius,
        FOOT_LOOK,
        FOOT_REACH,
    )
    return reorder(replace(skeleton, parent=parent), sort_topological(parent))


def polish(xyz: np.ndarray, skeleton: Skeleton, rounds: int = POLISH_ROUNDS) -> Skeleton:
    """Fit the frusta of a simplified skeleton to the points once more."""
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    position, radius, _ = tubes.refine_tubes(
        xyz,
        chains.point_start,
        chains.point,
        skeleton.parent,
        chains.onward,
        skeleton.position,
        skeleton.radius,
        skeleton.is_tube,
        skeleton.position,
        HOLD,
        rounds,
        POLISH_STIFFNESS,
        POLISH_RADIUS_STIFFNESS,
    )
    return replace(skeleton, position=position, radius=np.minimum(radius, skeleton.thickest))
