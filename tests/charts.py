"""Canonical coordinates of turning bodies, for Jacobians of flows."""

import numpy as np

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
