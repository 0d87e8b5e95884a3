"""Least squares and the covariance of what they find; it knows nothing of what is estimated."""

from rover_estimation.covariance import (
    STANDARD_ERRORS,
    UNOBSERVABLE,
    grouped_gradients,
    inverse_curvature,
    sandwich,
)
from rover_estimation.search import Floats, Minimum, minimise

__all__ = [
    "STANDARD_ERRORS",
    "UNOBSERVABLE",
    "Floats",
    "Minimum",
    "grouped_gradients",
    "inverse_curvature",
    "minimise",
    "sandwich",
]
