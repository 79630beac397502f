"""Orientations over a pass under a motion model, many candidates at once, with their derivatives (docs/motion.md).

A candidate is (orientation q0 body -> fixed frame and angular velocity w0 in body axes at a reference time, s). Turns
of q0 are counted on the fixed side: q0 -> exp(a) q0. The tangent of an orientation is body-side, as in ``pose``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.inference.pose import conjugate, exp_so3, log_so3, multiply, rotation_matrices
from service.inference.state import Array

_STEP_RAD = 0.3  # numerical: turn of a step of the integration; over 50 rad its error is 1e-5 rad
FARTHEST_RAD = 600.0  # numerical: a free body is followed no further from the reference time
_DIFFERENCE = 1e-5  # numerical: of a difference quotient, rad/s and log
# exact: axes in turn; an orthonormal basis of symmetric tensors without a trace
_ROOT_HALF = np.sqrt(0.5)
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
INERTIA_BASIS = np.array(
    [
        [[_ROOT_HALF, 0, 0], [0, -_ROOT_HALF, 0], [0, 0, 0]],
        [[6**-0.5, 0, 0], [0, 6**-0.5, 0], [0, 0, -2 * 6**-0.5]],
        [[0, _ROOT_HALF, 0], [_ROOT_HALF, 0, 0], [0, 0, 0]],
        [[0, 0, _ROOT_HALF], [0, 0, 0], [_ROOT_HALF, 0, 0]],
        [[0, 0, 0], [0, 0, _ROOT_HALF], [0, _ROOT_HALF, 0]],
    ]
)
"""(5, 3, 3) orthonormal, symmetric, traceless: directions in which the log of a mass distribution differs."""
N_INERTIA = len(INERTIA_BASIS)


@dataclass(frozen=True)
class Motions:
    """B candidates of a motion; ``shape`` (B, 5) for bodies that tumble freely, (B, 0) for constant rates.

    A body's masses have the second moments exp(sum_i shape_i INERTIA_BASIS_i) up to a factor, which is positive
    definite whatever ``shape`` is; so its moments of inertia obey the triangle's inequality.
    """

    quaternion: Array  # (B, 4) body -> fixed at the reference time
    rate: Array  # (B, 3) rad/s in body axes at the reference time
    shape: Array  # (B, 5) or (B, 0)

    def __len__(self) -> int:
        return len(self.rate)

    def __getitem__(self, index: slice | NDArray[np.intp] | NDArray[np.bool_]) -> Motions:
        return Motions(self.quaternion[index], self.rate[index], self.shape[index])

    @property
    def n_parameters(self) -> int:
        """6, or 11 with inertia."""
        return 6 + int(self.shape.shape[1])


def moved(motions: Motions, step: Array) -> Motions:
    """The candidates after steps (B, 6 or 11): turn of q0 in fixed axes (rad), rate (rad/s), shape."""
    return Motions(
        multiply(exp_so3(step[:, :3]), motions.quaternion), motions.rate + step[:, 3:6], motions.shape + step[:, 6:]
    )


def stacked(*batches: Motions) -> Motions:
    """Several batches as one."""
    parts = ([getattr(b, name) for b in batches] for name in ("quaternion", "rate", "shape"))
    return Motions(*(np.concatenate(part) for part in parts))


def inertia(shape: Array) -> Array:
    """(..., 3, 3) moments of inertia of ``shape`` (..., 5) about the centre of mass, of trace 1: tr(S) 1 - S."""
    values, vectors = np.linalg.eigh(np.einsum("...i,ijk->...jk", shape, INERTIA_BASIS))
    masses = np.einsum("...ij,...j,...kj->...ik", vectors, np.exp(values), vectors)
    total = np.trace(masses, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray((total * np.eye(3) - masses) / (2 * total))


def shape_of(second_moments: Array) -> Array:
    """(5,) ``shape`` of a body with these second moments of mass (3, 3), positive definite."""
    values, vectors = np.linalg.eigh(second_moments)
    logs = (vectors * np.log(np.maximum(values, 1e-6 * values.max()))) @ vectors.T
    return np.asarray(np.einsum("ijk,jk->i", INERTIA_BASIS, logs))


def orientations(motions: Motions, elapsed_s: Array) -> Array:
    """(B, n, 4) orientations at times (n,) since the reference time, in rising order."""
    return multiply(motions.quaternion[:, None], _turns(motions.rate, motions.shape, elapsed_s)[0])


def rates_at(motions: Motions, elapsed_s: Array) -> Array:
    """(B, n, 3) angular velocities in body axes, rad/s."""
    return _turns(motions.rate, motions.shape, elapsed_s)[1]


def with_derivatives(motions: Motions, elapsed_s: Array) -> tuple[Array, Array]:
    """(B, n, 4) orientations and (B, n, 3, P) their body-side derivatives by the steps of ``moved``."""
    turns, _ = _turns(motions.rate, motions.shape, elapsed_s)
    q = multiply(motions.quaternion[:, None], turns)
    out = np.empty((*q.shape[:2], 3, motions.n_parameters))
    out[..., :3] = np.swapaxes(rotation_matrices(q), -1, -2)  # R(q)' a: a turn of all in fixed axes
    if not motions.shape.shape[1]:
        out[..., 3:] = elapsed_s[:, None, None] * right_jacobians(motions.rate[:, None] * elapsed_s[:, None])
        return q, out
    count, free = len(motions), motions.n_parameters - 3
    shifts = _DIFFERENCE * np.eye(free)
    rates = (motions.rate[:, None] + shifts[:, :3]).reshape(-1, 3)
    shapes = (motions.shape[:, None] + shifts[:, 3:]).reshape(-1, free - 3)
    near = _turns(rates, shapes, elapsed_s, at_least=motions.rate)[0].reshape(count, free, len(elapsed_s), 4)
    same = _turns(motions.rate, motions.shape, elapsed_s, at_least=rates)[0]
    out[..., 3:] = np.moveaxis(log_so3(multiply(conjugate(same)[:, None], near)), 1, -1) / _DIFFERENCE
    return q, out


def right_jacobians(vectors: Array) -> Array:
    """(..., 3, 3) J with exp(a + e) = exp(a) exp(J e) to first order in e (Chirikjian 2012, eq. 10.86)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    safe = np.maximum(angle, 1e-4)
    first = np.where(angle < 1e-4, 0.5, (1 - np.cos(safe)) / safe**2)
    second = np.where(angle < 1e-4, 1 / 6, (safe - np.sin(safe)) / safe**3)
    skew = cross_matrices(vectors)
    return np.asarray(np.eye(3) - first * skew + second * skew @ skew)


def cross_matrices(vectors: Array) -> Array:
    """(..., 3, 3) matrices of v x."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape[:-1], 3, 3)


def _cross(a: Array, b: Array) -> Array:
    """a x b; a fourth of the time of NumPy's."""
    return np.asarray(a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT])


def _turns(rates: Array, shapes: Array, elapsed_s: Array, at_least: Array | None = None) -> tuple[Array, Array]:
    """(B, n, 4) turns since the reference time, in body axes there, and (B, n, 3) rates.

    ``at_least``: rates (., 3) whose steps are to be as short; batches that are compared take the same steps.
    """
    if not shapes.shape[1]:
        w = np.broadcast_to(rates[:, None], (len(rates), len(elapsed_s), 3))
        return exp_so3(w * elapsed_s[:, None]), w
    compared = np.concatenate([rates] if at_least is None else [rates, at_least])
    fastest = float(np.sqrt(np.max(np.sum(compared**2, axis=1))))
    out, w = np.empty((len(rates), len(elapsed_s), 4)), np.empty((len(rates), len(elapsed_s), 3))
    moments = inertia(shapes)
    for sign, at in ((1.0, elapsed_s >= 0), (-1.0, elapsed_s < 0)):
        if np.any(at):
            out[:, at], w[:, at] = _integrated(rates, moments, sign * elapsed_s[at], sign, fastest)
    return out, w


def _integrated(rates: Array, moments: Array, elapsed_s: Array, sign: float, fastest: float) -> tuple[Array, Array]:
    """Euler's equations I w' = I w x w in principal axes by Runge and Kutta's fourth-order rule, then q' = q w / 2.

    Each step's turn is Magnus's to fourth order.
    """
    span = float(np.max(elapsed_s))
    n_steps = int(np.clip(np.ceil(fastest * span / _STEP_RAD), 4, 2 * FARTHEST_RAD / _STEP_RAD))
    h = span / n_steps if span > 0 else 1.0
    principal, axes = np.linalg.eigh(moments)
    axes[..., 0] *= np.linalg.det(axes)[:, None]
    factor = sign * (principal[:, _NEXT] - principal[:, _AFTER]) / principal

    def change(w: Array) -> Array:
        return np.asarray(factor * w[:, _NEXT] * w[:, _AFTER])

    w = np.empty((n_steps + 1, *rates.shape))
    w[0] = np.einsum("bji,bj->bi", axes, rates)
    for k in range(n_steps):
        k1 = change(w[k])
        k2 = change(w[k] + 0.5 * h * k1)
        k3 = change(w[k] + 0.5 * h * k2)
        w[k + 1] = w[k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + change(w[k] + h * k3))
    bends = factor * w[..., _NEXT] * w[..., _AFTER]
    halfway = 0.5 * (w[:-1] + w[1:]) + h / 8 * (bends[:-1] - bends[1:])
    halfway, nodes = (np.einsum("bij,nbj->bni", axes, one) for one in (halfway, w))
    turns = sign * h / 6 * (nodes[:, :-1] + 4 * halfway + nodes[:, 1:]) + h**2 / 12 * _cross(
        nodes[:, :-1], nodes[:, 1:]
    )
    q = np.concatenate([np.tile([1.0, 0.0, 0.0, 0.0], (len(rates), 1, 1)), _products(exp_so3(turns))], axis=1)
    index = np.clip((elapsed_s / h).astype(int), 0, n_steps - 1)
    return _between(q[:, index], nodes, index, elapsed_s / h - index, sign * h)


def _products(q: Array) -> Array:
    """(B, n, 4) products of all quaternions up to each, in order."""
    reach = 1
    while reach < q.shape[1]:
        q = np.concatenate([q[:, :reach], multiply(q[:, :-reach], q[:, reach:])], axis=1)
        reach *= 2
    return q


def _between(q: Array, w: Array, index: Array, share: Array, h: float) -> tuple[Array, Array]:
    """Inside of a step: the rate a parabola's through three nodes, the turn its integral with Magnus's second term."""
    first = np.minimum(index, w.shape[1] - 3)
    a, b, c = w[:, first], w[:, first + 1], w[:, first + 2]
    x = (share + index - first)[:, None]
    x0 = (index - first).astype(np.float64)[:, None]

    def rate(x: Array) -> Array:
        return np.asarray(a + x * (b - a) + 0.5 * x * (x - 1) * (a - 2 * b + c))

    start, middle, end = rate(x0), rate(0.5 * (x0 + x)), rate(x)
    dt = share[:, None] * h
    turn = dt / 6 * (start + 4 * middle + end) + dt**2 / 12 * _cross(start, end)
    return multiply(q, exp_so3(turn)), end


def places(first_s: float, last_s: float) -> Array:
    """(16,) uneven times over a span, in rising order: motions that meet at even ones are apart at some of them."""
    # exact: the golden ratio's
    golden = np.sort(np.arange(15) * 0.6180339887498949 % 1.0)
    return first_s + (last_s - first_s) * np.append(golden, 1.0)


def at_other_time(motions: Motions, elapsed_s: float) -> Motions:
    """The same motions told at a reference time that is later by ``elapsed_s``."""
    at = np.array([elapsed_s])
    return replace(motions, quaternion=orientations(motions, at)[:, 0], rate=rates_at(motions, at)[:, 0])
