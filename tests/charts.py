"""Canonical coordinates of turning bodies, for Jacobians of flows."""

import numpy as np

from openmm_exactrb import quaternions


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
    """Return the Jacobian of a map by central differences of order 4."""
    columns = [
        (8 * (step(x0 + d * e) - step(x0 - d * e)) - (step(x0 + 2 * d * e) - step(x0 - 2 * d * e))) / (12 * d)
        for e in np.eye(len(x0))
    ]
    return np.array(columns).T


def symplectic_defect(J):
    """Return the largest entry of J^T form J - form, for coordinates in blocks of three places and three momenta."""
    block = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    form = np.kron(np.eye(len(J) // 6), block)
    return np.abs(J.T @ form @ J - form).max()
