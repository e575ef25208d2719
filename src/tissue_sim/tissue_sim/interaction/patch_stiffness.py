"""How stiff tissue is against a patch once it has followed: learned from motions and forces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SMALLEST_SHARE = 1e-3
"""Least share of the sensed stiffness that is believed to remain."""

SOFTEST = 1e-9
"""Least sensed stiffness, as a share of the largest."""

LEAST_COSINE = 1e-3
"""Of the angle between an error and its motion; below, the correction could be anything."""

LEAST_MOTION = 1e-5
"""A smaller motion, in sizes of the patch, teaches nothing but rounding."""


class LearnedStiffness:
    """What remains of a sensed stiffness D once the tissue has followed: D^1/2 M D^1/2.

    M begins as 1 and stays between 0 and 1, as it is for tissue at rest. Each motion from one
    equilibrium to the next and the change of force that came of it correct M by the symmetric
    change of rank one that explains them: six motions tell all about linear tissue.

    References:
        Nocedal, J. and Wright, S. J. (2006): Numerical Optimization, section 6.2 (SR1).

    Attributes:
        matrix: The stiffness to reckon with, shape (6, 6).
    """

    def __init__(self) -> None:
        """Begin with nothing known."""
        self.matrix = np.zeros((6, 6))
        self._root, self._inverse_root = np.eye(6), np.eye(6)
        self._share = np.eye(6)

    def forget(self) -> None:
        """All of the sensed stiffness remains, as far as is known."""
        self._share = np.eye(6)

    def sense(self, values: NDArray[np.float64], vectors: NDArray[np.float64]) -> None:
        """Take the sensed stiffness, by its eigenvalues and eigenvectors."""
        roots = np.sqrt(np.maximum(values, max(SOFTEST * float(values.max()), 1e-12)))
        self._root = (vectors * roots) @ vectors.T
        self._inverse_root = (vectors / roots) @ vectors.T
        self.matrix = self._root @ self._share @ self._root

    def learn(self, motion: NDArray[np.float64], change: NDArray[np.float64]) -> None:
        """Take note of what a motion changed in the tissue's force, shapes (6,)."""
        z, w = self._root @ motion, -(self._inverse_root @ change)
        r = w - self._share @ z
        along = float(r @ z)
        if abs(along) <= LEAST_COSINE * np.linalg.norm(r) * np.linalg.norm(z):
            return
        share = self._share + np.outer(r, r) / along
        values, vectors = np.linalg.eigh(share)
        self._share = (vectors * np.clip(values, SMALLEST_SHARE, 1.0)) @ vectors.T
        self.matrix = self._root @ self._share @ self._root
