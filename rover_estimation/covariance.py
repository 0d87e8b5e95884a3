"""Covariance of unknowns that least squares found."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rover_estimation.search import Floats

STANDARD_ERRORS: Final = 1.959964
"""Half of a 95 % interval, in standard errors."""
UNOBSERVABLE: Final = 1e-3
"""Singular value of the derivatives, over the residuals' errors, of an unobservable direction."""


def inverse_curvature(jacobian: Floats) -> Floats:
    """Inverse of the curvature, (n, n); unobservable directions get a large variance.

    Args:
        jacobian: derivatives of residuals with independent errors of size 1, (m, n).
    """
    _, values, directions = np.linalg.svd(jacobian, full_matrices=False)
    inverse = 1.0 / np.maximum(values, UNOBSERVABLE) ** 2
    return np.asarray((directions.T * inverse) @ directions)


def grouped_gradients(jacobian: Floats, residuals: Floats, groups: NDArray[np.int_]) -> Floats:
    """Gradients of half the sum of squares of each group of residuals, (groups, n).

    Args:
        jacobian: derivatives, (m, n).
        residuals: (m,).
        groups: number of each residual's group, from 0, (m,).
    """
    sums = np.zeros((int(groups.max()) + 1, jacobian.shape[1]))
    np.add.at(sums, groups, jacobian * residuals[:, None])
    return sums


def sandwich(bread: Floats, gradients: Floats) -> Floats:
    """Covariance for residuals whose errors are correlated within groups, (n, n).

    Args:
        bread: inverse of the curvature, as `inverse_curvature` returns it, (n, n).
        gradients: of each group, (groups, n).
    """
    return np.asarray(bread @ (gradients.T @ gradients) @ bread)
