"""Canonical coordinates of turning bodies and of constrained clusters, for Jacobians of flows."""

import numpy as np

from openmm_exactrb.constraints.clusters import ClusterState
from openmm_exactrb.mathematics import quaternions


def state_at(q_ref, x):
    """Return q (4, 1) and m (3, 1) at coordinates (theta, pi): q = q_ref exp(theta/2), m dual to theta there."""
    theta, p = x[:3], x[3:]
    angle = np.linalg.norm(theta)
    half = np.concatenate([[np.cos(angle / 2)], np.sinc(angle / 2 / np.pi) / 2 * theta])
    return quaternions.multiply(q_ref, half[:, None]), (np.linalg.inv(tangent(theta)).T @ p)[:, None]


def coordinates_of(q_ref, q, m):
    """Return (theta, pi) of q (4, 1) and m (3, 1)."""
    relative = quaternions.multiply(q_ref * np.array([[1], [-1], [-1], [-1]]), q)[:, 0]
    relative *= np.sign(relative[0])
    norm = np.linalg.norm(relative[1:])
    theta = 2 * np.arctan2(norm, relative[0]) * relative[1:] / norm if norm > 0 else 2 * relative[1:]
    return np.concatenate([theta, tangent(theta).T @ m[:, 0]])


def tangent(theta):
    """Return the matrix that makes the body angular velocity of theta-dot."""
    angle = np.linalg.norm(theta)
    hat = np.array([[0, -theta[2], theta[1]], [theta[2], 0, -theta[0]], [-theta[1], theta[0], 0]])
    first = np.sinc(angle / 2 / np.pi) ** 2 / 2
    second = 1 / 6 - angle**2 / 120 if angle < 1e-2 else (angle - np.sin(angle)) / angle**3
    return np.eye(3) - first * hat + second * hat @ hat


def jacobian(step, x0, d=1e-3):
    """Return the Jacobian of a map by central differences of order 4.

    Parameters
    ----------
    step : callable
        step(x) -> (k, n), what the n columns of x (k, n) are taken to.
    x0 : (k,) array
    d : float
    """
    k = len(x0)
    shifts = d * np.hstack([np.eye(k), -np.eye(k), 2.0 * np.eye(k), -2.0 * np.eye(k)])
    near, opposite, far, far_opposite = np.hsplit(step(x0[:, None] + shifts), 4)
    return (8.0 * (near - opposite) - (far - far_opposite)) / (12.0 * d)


def symplectic_defect(J):
    """Return the largest entry of J^T form J - form, for coordinates in blocks of three places and three momenta."""
    block = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    form = np.kron(np.eye(len(J) // 6), block)
    return np.abs(J.T @ form @ J - form).max()


class ClusterChart:
    """Canonical coordinates about a place of one cluster: x = x0 + T xi + M^-1 G0^T mu, pi = (dx/dxi)^T p."""

    def __init__(self, clusters, state):
        self.kind, self.n = clusters.kinds[0], clusters.mass.size
        self.x0, self.mass = state.x[0].T.ravel(), np.repeat(clusters.mass, 3)
        self.G0 = self.gradients(self.x0)
        root = np.sqrt(self.mass)
        _, _, Vt = np.linalg.svd(self.G0 / root)
        self.T = (Vt[len(self.G0) :] / root).T

    def gradients(self, x):
        x, (i, j) = x.reshape(-1, 3), self.kind.pairs.T
        G = np.zeros((len(i), self.n, 3))
        G[np.arange(len(i)), i], G[np.arange(len(i)), j] = x[i] - x[j], x[j] - x[i]
        return G.reshape(len(i), -1)

    def tangents(self, x):
        G, normal = self.gradients(x), (self.G0 / self.mass).T
        return self.T - normal @ np.linalg.solve(G @ normal, G @ self.T)

    def state(self, z):
        xi, pi = np.split(z, 2)
        x, normal = self.x0 + self.T @ xi, (self.G0 / self.mass).T
        for _ in range(12):
            r = np.subtract(*x.reshape(-1, 3)[self.kind.pairs.T])
            x = x + normal @ np.linalg.solve(
                self.gradients(x) @ normal, (self.kind.lengths**2 - (r * r).sum(axis=1)) / 2
            )
        J = self.tangents(x)
        p = self.mass * (J @ np.linalg.solve(J.T @ (self.mass[:, None] * J), pi))
        high = np.array([x, p]).reshape(2, -1, 3).swapaxes(1, 2)
        return ClusterState(*(np.stack([a, np.zeros(a.shape)]) for a in high))

    def coordinates(self, state):
        x, p = ((a[0] + a[1]).T.ravel() for a in state)
        return np.concatenate([self.T.T @ (self.mass * (x - self.x0)), self.tangents(x).T @ p])
