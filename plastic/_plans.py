"""What the kernels of the transformation are given and fill: arrays in named tuples, and their steps."""

from typing import NamedTuple

import numpy as np

ALIVE = np.int32(2**30)
BY_LIGHT, BY_OBSTACLE = np.uint8(1), np.uint8(2)  # what a branch died of
STEP = 1.0 / 1024.0  # changes of light, in its amount and its direction, are multiples of this
GRAIN = 0.25  # offsets of clusters are multiples of this share of their radius
SLACK = 1.0 - 1e-12  # so that rounding prunes nothing at a strength of 1
UNSEEN = 0.25 * STEP  # an obstacle that can take less light than this is not looked at


class Plan(NamedTuple):
    """What does not depend on the surroundings: n nodes and s sites of k trees."""

    node_first: np.ndarray  # (k, seasons + 1) int32: nodes of a tree's season
    site_first: np.ndarray  # (k, seasons + 2) int32: sites of a tree's group; 0 at its end
    parent: np.ndarray  # (n,) int32
    position: np.ndarray  # (n, 3) as it came in
    heading: np.ndarray  # (n, 3) unit direction as it came in
    length: np.ndarray  # (n,)
    rest: np.ndarray  # (n, 3) w_s d_o
    lean: np.ndarray  # (n, 3) (1 - w_s) t in the light of the analysis
    pull: np.ndarray  # (n,) (1 - w_s) times the share of phototropism
    look: np.ndarray  # (n,) int32: site whose light it grows in, or -1
    least: np.ndarray  # (n,) min(psi_ref, min over t of psi_s(t)), m; 0: light never prunes it
    slack: np.ndarray  # (k, seasons) greatest least / psi_s(t) of a tree's season
    center: np.ndarray  # (s, 3)
    radius: np.ndarray  # (s,)
    translucency: np.ndarray  # (s,)
    gain: np.ndarray  # (s,) 2 pi r^2 for each seat
    seat_first: np.ndarray  # (s + 1,) int32
    seat: np.ndarray  # (m,) int32
    amount: np.ndarray  # (s,) light at the analysis
    toward: np.ndarray  # (s, 3) its mean direction, 0 without light
    passed: np.ndarray  # (s, cells) float32: what the clusters of its tree let through; may have no rows
    around: np.ndarray  # (s,) factor of the clusters that contain the site


class Events(NamedTuple):
    """What happens when: an event is one season of some of the trees."""

    first: np.ndarray  # (e + 1,) int32
    tree: np.ndarray  # (a,) int32
    season: np.ndarray  # (a,) int32
    group: np.ndarray  # (e, k) int32: last group of each tree that is there at the end of the event; -1 none
    near_first: np.ndarray  # (k + 1,) int32
    near: np.ndarray  # int32: other trees that can take light from it


class Work(NamedTuple):
    """What comes out, and what a session keeps of it."""

    position: np.ndarray  # (n, 3)
    turn: np.ndarray  # (n, 9) rotation of the segment; read only where `turned`
    turned: np.ndarray  # (n,) bool: not as it came in
    valid: np.ndarray  # (n,) bool: position and turn belong to the last light of its site
    dirty: np.ndarray  # (n,) bool: worked out anew in this run
    death: np.ndarray  # (n,) int32: event, or ALIVE
    cause: np.ndarray  # (n,) uint8
    offset: np.ndarray  # (s, 3) mean of its living seats
    center: np.ndarray  # (s, 3) where it is
    local: np.ndarray  # (s, 3) where it is against the other clusters of its group
    living: np.ndarray  # (s,) int32 seats that live
    translucency: np.ndarray  # (s,)
    changed: np.ndarray  # (s,) bool: for its own tree another cluster than in the last run
    moved: np.ndarray  # (s,) bool: for other trees and obstacles too
    former: np.ndarray  # (s, 3) `local` as it was in the last run
    earlier: np.ndarray  # (s, 3) `center` as it was
    amount: np.ndarray  # (s,)
    shift: np.ndarray  # (s, 3) change of the light's direction
    shifted: np.ndarray  # (s,) bool: it is not that of the last run
    lit: np.ndarray  # (s,) bool: an obstacle took light from it
    passed: np.ndarray  # (s, cells) float32: what its own tree lets through; kept if it has rows
    around: np.ndarray  # (s,)
    beyond: np.ndarray  # (s, cells) float32: what the other trees let through; no rows for a single tree
    outside: np.ndarray  # (s,)
    gathered: np.ndarray  # (n,) scratch
    carried: np.ndarray  # (n,) scratch
    affected: np.ndarray  # (k,) bool: something of the tree is not as it came in
    fallen: np.ndarray  # (k,) bool: a branch died
    news: np.ndarray  # (k,) bool: a node may not be as in the last run, so that clusters have to be looked at
    bent: np.ndarray  # (k, seasons) bool: a living node of the season is turned
    stirred: np.ndarray  # (k, seasons) bool: a node of it may be dirty
    boxed: np.ndarray  # (k, seasons) bool: `box` is of the nodes as they are
    box: np.ndarray  # (k, seasons, 7) lowest and highest corner of a season's nodes, and its longest segment
    buried: np.ndarray  # (k,) bool: its foot is inside an obstacle
    counts: np.ndarray  # (4,) int64: sites shaded by clusters, by obstacles, weighed, nodes turned


class Sky(NamedTuple):
    """The cells of the sky and their light."""

    grid: tuple
    fine: np.ndarray
    weight: np.ndarray
    reach: np.ndarray  # (2,) blur and tent, radians
    bright: np.ndarray  # (4,) brightest direction, and the light of a unit of solid angle there


class Solids(NamedTuple):
    """Obstacles as the light kernels want them, and balls around the boxes."""

    planes: np.ndarray
    balls: np.ndarray
    boxes: np.ndarray
    bounds: np.ndarray  # (balls + boxes, 4) centre, radius


class Rules(NamedTuple):
    """Strengths, and what of the last run still holds."""

    bending: float
    pruning: float
    rebend: bool  # all segments whose light differs from the analysis
    reshade: bool  # all sites, by clusters
    relight: bool  # all sites that obstacles reach, or reached
    reweigh: bool  # all sites: the sky is another
    first: bool  # the analysis: light as it is, not as steps from that of the analysis
