"""Normal equations of a link: added up by the two views and the few nodes of the hall that it depends on, then carried
over to the parameters by the chain rule."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pzcap.calibration.parameters import ViewJacobians
from pzcap.calibration.transfer import SIDES, Transfer
from pzcap.geometry.camera import HIGHER, VIEW
from pzcap.geometry.cylinder import NODES, Hall
from pzcap.types import Array


class LinkSums(NamedTuple):
    """Normal equations of one link, by both views with their lens (S = SIDES) and by the nodes of the hall that it
    touches, numbered as they come."""

    views: Array  # (S, S)
    by_views: Array  # (S,) gradient
    cross: Array  # (K, S) nodes by views
    nodes: Array  # (K, K)
    by_nodes: Array  # (K,) gradient
    number: NDArray[np.int64]  # (K,) of each node of the hall; -1 where it is not touched
    used: NDArray[np.int64]  # (K,) the node that has a number


@njit(cache=True, nogil=True)
def new_link_sums(hall: Hall) -> LinkSums:
    """Sums for any link: `add_link` leaves them ready for the next."""
    most = hall[1].size + hall[2].size
    number, used = np.full(most, -1), np.empty(most, np.int64)
    sums = np.empty((SIDES, SIDES)), np.empty(SIDES), np.empty((most, SIDES)), np.empty((most, most)), np.empty(most)
    return LinkSums(*sums, number, used)


@njit(cache=True, nogil=True)
def add_nodes(
    sums: LinkSums, count: int, seen: Transfer, along: Array, weight: float, pull: float, touched: NDArray[np.int64]
) -> int:
    """Add the part of a pixel's residuals that depends on the nodes of the hall; how many are touched by then, of
    which ``count`` were before. By inverse distance, ``along`` (S,) is the normal matrix's row of both views,
    ``weight`` its diagonal and ``pull`` the gradient; ``touched`` (NODES,) takes the numbers of the pixel's nodes."""
    _, _, cross, nodes, by_nodes, number, used = sums
    for k in range(NODES):
        node = seen.nodes[k]
        if number[node] < 0:
            number[node], used[count] = count, node
            cross[count, :], nodes[count, : count + 1], nodes[:count, count], by_nodes[count] = 0.0, 0.0, 0.0, 0.0
            count += 1
        touched[k] = number[node]
    for k in range(NODES):
        i, share = touched[k], seen.shares[k]
        by_nodes[i] += share * pull
        for j in range(SIDES):
            cross[i, j] += share * along[j]
        for other in range(NODES):
            nodes[i, touched[other]] += share * weight * seen.shares[other]
    return count


@njit(cache=True, nogil=True)
def add_link(
    sums: LinkSums, count: int, jacobians: ViewJacobians, ends: NDArray[np.int64], normal: Array, gradient: Array
) -> None:
    """Add a link's sums, ``count`` nodes among them, to those of the parameters by the chain rule, and forget which
    nodes they were."""
    columns, width = jacobians.columns, jacobians.columns.shape[1]
    own = 2 * width + HIGHER  # columns of both views' own parameters, and of the lens
    chain, into = np.zeros((SIDES, own)), np.empty(own, np.int64)
    for side in range(2):
        chain[side * VIEW : (side + 1) * VIEW, side * width : (side + 1) * width] = jacobians.by_parameters[ends[side]]
        into[side * width : (side + 1) * width] = columns[ends[side]]
    chain[2 * VIEW :, 2 * width :] = np.eye(HIGHER)
    into[2 * width :] = jacobians.higher + np.arange(HIGHER)
    whole, part, cross = chain.T @ (sums.views @ chain), chain.T @ sums.by_views, sums.cross[:count] @ chain
    for i in range(own):
        gradient[into[i]] += part[i]
        for j in range(own):
            normal[into[i], into[j]] += whole[i, j]
    hall = columns.max() + 1  # it comes after all that a view depends on
    for k in range(count):
        row = hall + sums.used[k]
        gradient[row] += sums.by_nodes[k]
        for i in range(own):
            normal[row, into[i]] += cross[k, i]
            normal[into[i], row] += cross[k, i]
        for other in range(count):
            normal[row, hall + sums.used[other]] += sums.nodes[k, other]
        sums.number[sums.used[k]] = -1
