"""Which components do not lie on the other sweep, from a few points of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from upvl_cli.perception.flow.config import RigidFlowConfig
from upvl_cli.perception.flow.groups import static_poses
from upvl_cli.perception.flow.search import FlowState, Labelled, sample_surface
from upvl_cli.perception.flow.surface import LocalSurface, misfit
from upvl_cli.types import Bools, Floats, Ints


class Screen(NamedTuple):
    """Components of which the other sweep leaves some point unexplained.

    Attributes:
        component: (k,) the components, ascending.
        size: (k,) points of each in the first sweep.
        points: A few points of each.
        misfit: (k,) misfit of these at rest.
        has_residual: (k,) whether enough points are unexplained to be the ends of a thing that slides along itself.
    """

    component: Ints
    size: Ints
    points: LocalSurface
    misfit: Floats
    has_residual: Bools


def screen_components(
    state: FlowState, labelled: Labelled, is_residual: Bools, config: RigidFlowConfig
) -> Screen:
    """Return the components that have points which the other sweep does not explain at rest.

    Args:
        state: The sweeps.
        labelled: All points of the first sweep and their components.
        is_residual: (n,) which of these points the second does not explain at rest.
        config: The method's settings.
    """
    total = int(labelled.group.max(initial=-1)) + 1
    size = np.bincount(labelled.group[labelled.group >= 0], minlength=total)
    residual = np.bincount(labelled.group[is_residual & (labelled.group >= 0)], minlength=total)
    component = np.flatnonzero((size >= config.icp.min_pairs) & (residual > 0))
    points = sample_surface(state, labelled.among(component), len(component), config.screen_points, config)
    enough = residual >= np.maximum(config.evidence.min_points, config.evidence.min_share * size)
    at_rest = misfit(points, state.target_tree, static_poses(points.groups))
    return Screen(component, size[component], points, at_rest, enough[component])
