"""log p(D|theta) of docs/model.md, section 3: the light of one pose against one patch, linear unknowns integrated out.

The readable twin of ``gpu/kernels/evidence.cl``; NumPy, one pose at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import lgamma, log, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.inference.model import prior
from service.inference.model.drawing import EVEN_PLANES, Cut
from service.inference.model.scene import Images
from service.inference.model.spread import deviations, gradient, spread
from service.inference.model.terms import Terms
from service.inference.state import Array

_NU = prior.DEGREES_OF_FREEDOM
_T_CONSTANT = lgamma((_NU + 1) / 2) - lgamma(_NU / 2) - 0.5 * log(_NU * pi)  # exact: of its height
ROUNDS = 6  # numerical: of reweighting: the evidence moves by less than 0.1 nats after it
STILL = 1e-2  # numerical: nats: a step that promises less is not worth another look, and is not taken
LEAST_LIT = 1e-4  # numerical: of the Sun full on: a plane that shows less is left out
_LONGEST_STEP = 1.5  # numerical: of a log albedo in one round
_PACES = (0.4, 2.0)  # numerical: least and greatest share of a step that is taken
_MOST = (np.inf, 1.0)  # prior: of even light, and of the sky that is hidden
_FIRM = 1e8  # numerical: times the curvature of an unknown that is to go nowhere else


@dataclass(frozen=True)
class Fit:
    """A pose's light at its best: ``gpu.evidence.Details`` and what goes with them."""

    planes: Images | Cut  # (1, Q, S, S) as drawn: groups, coverage, normals, gloss
    log_evidence: float
    chi2: float  # mean square of residual over its scale, on the body
    coefficients: Images  # (Q,) of the drawing's planes: what ``combined`` draws the same light with
    values: Images  # (U,) of all unknowns, in the order of ``Terms``; of planes that show no light what is expected
    residual: Images  # (S, S)
    weight: Images  # (S, S) precision of a pixel, over A
    model: Images  # (S, S) what the frame should look like after its low pass
    light: Images  # (S, S) the body's part of it
    window: tuple[slice, slice]  # rows and columns beyond which no pose near by changes anything
    columns: Images  # (M, rows, columns) derivatives of the model by the unknowns, in the window
    precision: Array  # (M,) of the priors, of facets about what their piece has in common
    deviation: Array  # (M,) of the unknowns from their prior means
    normal: Array  # (M, M) curvature of the log posterior by the unknowns
    pull: Array  # (M,) its slope
    lit: NDArray[np.intp]  # numbers of the positive planes that show light: the first of the M
    row: Any = None  # as a device tells it: ``gpu.evidence.Row``


def t_log_density(residual: Images, variance: Images, full: NDArray[np.bool_] | None = None) -> Images:
    """Student t with 4 degrees of freedom and scale squared ``variance``.

    ``full``: pixels of which only a least value is known. All that is more is as likely: theirs is t over its height.
    """
    height = _T_CONSTANT - 0.5 * np.log(variance)
    height = height if full is None else np.where(full, 0.0, height)
    return np.asarray(height - 0.5 * (_NU + 1) * np.log1p(residual**2 / (_NU * variance)), np.float32)


def _weigh_stars(terms: Terms, residual: Images, variance: Images, weight: Images) -> float:
    """Nats by which stars better the whole: light apart from the object's may be one's. ``weight`` changes with it.

    A star adds to what the body leaves. Where there is one, a model of less light than is seen tells nothing.
    """
    gained = 0.0
    lost = 0.5 * (_NU + 1) * np.log1p(residual**2 / (_NU * variance)) / terms.area
    for number in np.unique(terms.stars[terms.stars > 0]):
        brighter = (terms.stars == number) & (residual > 0)
        better = float(np.sum(lost[brighter], dtype=np.float64)) - terms.star
        gained += float(np.logaddexp(0.0, better))
        weight[brighter] *= np.float32(np.exp(-np.logaddexp(0.0, better)))  # the share that it is the body's
    return gained


def fit_light(planes: Images, n_groups: int, terms: Terms, rounds: int = ROUNDS) -> Fit:
    """The linear unknowns of one pose by reweighted Gauss-Newton, and their Laplace evidence.

    ``planes`` (Q, S, S) as drawn: G groups, coverage, normals (3), gloss of the groups.
    """
    scene = terms.scene
    blurred = spread(planes, scene.point_spread, scene.smoothing)
    even = slice(n_groups, n_groups + EVEN_PLANES)
    positive = np.delete(np.arange(len(planes)), even)
    lit = np.flatnonzero(blurred[positive].max(axis=(1, 2)) > LEAST_LIT)
    unknowns = _Unknowns(terms, blurred[positive[lit]], blurred[even], lit)
    while rounds > 0 and unknowns.step() >= STILL:
        rounds -= 1
    fit = unknowns.result()
    gain = float(np.exp(unknowns.value[len(lit)]))
    values = terms.mean.copy()
    values[unknowns.kept] = unknowns.value
    values[: len(positive)] = _expected(terms, lit, unknowns.value[: len(lit)])
    coefficients = np.empty(len(planes), np.float32)
    coefficients[positive] = gain * np.exp(terms.offset + values[: len(positive)])
    coefficients[n_groups] = gain * unknowns.value[len(lit) + 1] - terms.hidden * unknowns.value[len(lit) + 2]
    coefficients[n_groups + 1 : even.stop] = np.exp(terms.gain) * unknowns.value[len(lit) + 6 : len(lit) + 9]
    return replace(fit, planes=planes[None], coefficients=coefficients, values=values, lit=lit)


def _law(terms: Terms, kept: NDArray[np.intp], n: int) -> tuple[Array, Array]:
    """Means (M,) and precision (M, M) of what is ``kept`` of the unknowns, of which n are positives."""
    mean, precision = terms.mean[kept].astype(np.float64), np.diag(terms.precision[kept].astype(np.float64))
    p, lit = len(terms.offset), kept[:n]
    if n:
        mean[:n] = terms.facets.expected(terms.mean[:p], terms.precision[:p])[0][lit]
        precision[:n, :n] = np.linalg.inv(terms.facets.covariance(terms.precision[:p])[np.ix_(lit, lit)])
    return mean, precision


def _expected(terms: Terms, lit: NDArray[np.intp], value: Array) -> Array:
    """(P,) positives where they are expected when those that are ``lit`` have these values."""
    p = len(terms.offset)
    mean, _ = terms.facets.expected(terms.mean[:p], terms.precision[:p])
    covariance = terms.facets.covariance(terms.precision[:p])
    if not len(lit):
        return mean
    return np.asarray(mean + covariance[:, lit] @ np.linalg.solve(covariance[np.ix_(lit, lit)], value - mean[lit]))


def _paced(pace: float, promised: float, last: Array, pull: Array) -> float:
    """How far the next step goes.

    Weights that follow the model overshoot along some unknowns, where steps turn back, and creep along others: as far
    as the last two say together (Aitken's).
    """
    if promised <= 0:
        return pace
    turned = 0.5 * float(pull @ last) / promised
    return float(np.clip(pace / max(1 - turned, 0.5 * _PACES[0]), *_PACES))


class _Unknowns:
    """The unknowns of one pose in the order of ``Terms``, positives that show no light left out."""

    def __init__(self, terms: Terms, positive: Images, even: Images, lit: NDArray[np.intp]) -> None:
        self._terms, self._positive, self._even, self._normals = terms, positive, even[0], even[1:]
        first = len(terms.offset)
        self.kept = kept = np.concatenate([lit, np.arange(first, len(terms.mean))])
        self._mean, self._prior = _law(terms, kept, len(lit))
        self._precision = terms.precision[kept].astype(np.float64)
        self._offset = terms.offset[lit].astype(np.float64)
        self._n = len(lit)
        self.value = self._mean.copy()
        self.gained = 0.0  # nats that stars explain
        self._pace = 1.0
        self._last: tuple[float, Array] = 0.0, np.zeros(len(kept))  # what the last step promised, and it
        if terms.start is None:
            self._start_gain()
        else:
            self.value = terms.start[0, kept].astype(np.float64)

    def _whole(self, shares: Array) -> Images:
        """The body's light at a gain of one, but for the even light's tilt."""
        sunlit = np.tensordot(shares.astype(np.float32), self._positive, 1)
        return np.asarray(sunlit + np.float32(self.value[self._n + 1]) * self._even)

    def _start_gain(self) -> None:
        """Least squares for one albedo: everything else follows from there."""
        whole = self._whole(np.exp(self._offset + self._mean[: self._n]))
        power, likeness = float(np.sum(whole * whole)), float(np.sum(whole * self._terms.data))
        if power > 0 and likeness > 0:
            self.value[self._n] = np.clip(log(likeness / power), self._terms.gain - 4, self._terms.gain + 4)

    def _model(self) -> tuple[Images, Images, Images]:
        """Columns (M, S, S), the body's light, and the model."""
        terms, n, value = self._terms, self._n, self.value
        gain, shares = float(np.exp(value[n])), np.exp(value[:n] + self._offset)
        grows = np.float32(gain) * self._whole(shares)
        normals = np.float32(np.exp(terms.gain)) * self._normals
        light = grows + np.tensordot(value[n + 6 : n + 9].astype(np.float32), normals, 1)
        scaled = (gain * shares).astype(np.float32)[:, None, None] * self._positive
        more = []
        if terms.speckle:
            more.append(deviations(light, terms.width))
        if terms.shifts:
            more += [terms.bumps * slope for slope in gradient(light)]
        model = light - np.float32(terms.hidden * value[n + 2]) * terms.behind * self._even
        model = model + np.tensordot(value[n + 3 : n + 6].astype(np.float32), terms.slopes, 1)
        if more:
            model = model + np.tensordot(value[n + 9 :].astype(np.float32), np.concatenate(more), 1)
        body = np.float32(gain) * self._even[None], -np.float32(terms.hidden) * self._even[None]
        columns = [scaled, grows[None], *body, terms.slopes, normals, *more]
        return np.concatenate(columns), light, np.asarray(model, np.float32)

    def _look(self) -> tuple[Images, Images, Images, Images, Images, Images]:
        """Columns, light, model, residual, its scale squared, and weights."""
        terms = self._terms
        columns, light, model = self._model()
        dx, dy = gradient(light)
        white = (terms.noise + terms.photon * np.maximum(light, 0)) / terms.area
        wrong = np.float32(terms.wrong) * (light**2 + np.float32(terms.edge**2) * (dx**2 + dy**2))
        variance = np.asarray(white + wrong, np.float32)
        residual = terms.data - model
        full = terms.full  # at least so much light: more is no contradiction, and tells nothing
        residual[full] = np.maximum(residual[full], 0.0)
        weight = np.asarray((_NU + 1) / ((_NU * variance + residual**2) * terms.area), np.float32)
        weight[full] *= np.minimum(residual[full] / np.sqrt(variance[full]), 1.0)
        self.gained = _weigh_stars(terms, residual, variance, weight)
        return columns, light, model, residual, variance, weight

    def step(self) -> float:
        """One round: weights from the residual, then a Gauss-Newton step, unless it promises too little; nats."""
        columns, _, _, residual, _, weight = self._look()
        normal, pull = self._system(columns, residual, weight)
        move = np.asarray(np.linalg.solve(*self._firm(normal + self._prior, pull)), np.float64)
        promised = 0.5 * float(pull @ move)
        if abs(promised) >= STILL:
            self._pace = _paced(self._pace, *self._last, pull)
            self._last = promised, move
            moved = self._pace * move
            moved[: self._n + 1] = np.clip(moved[: self._n + 1], -_LONGEST_STEP, _LONGEST_STEP)
            self.value = self.value + moved
            shares = slice(self._n + 1, self._n + 3)
            self.value[shares] = np.clip(self.value[shares], 0.0, _MOST)
        return abs(promised)

    def _system(self, columns: Images, residual: Images, weight: Images) -> tuple[Array, Array]:
        """J' W J, and the slope of the log posterior."""
        flat = columns.reshape(len(columns), -1)
        weighted = flat * weight.ravel()
        pull = (weighted @ residual.ravel()).astype(np.float64) - self._prior @ (self.value - self._mean)
        return (weighted @ flat.T).astype(np.float64), pull

    def _firm(self, normal: Array, pull: Array) -> tuple[Array, Array]:
        """Both, with unknowns that a step would take beyond the end of their range to go there, and no further.

        Even light is no less than nothing, and no more sky is hidden than there is: light without a discrepancy.
        """
        normal, pull = normal.copy(), pull.copy()
        free = dict(zip((self._n + 1, self._n + 2), _MOST, strict=True))
        for _ in _MOST:  # where one is held, the other may want to leave
            there = self.value + np.linalg.solve(normal, pull)
            for k in [k for k, most in free.items() if not 0.0 <= there[k] <= most]:
                normal[k, k] *= _FIRM
                pull[k] = normal[k, k] * (np.clip(there[k], 0.0, free.pop(k)) - self.value[k])
        return normal, pull

    def result(self) -> Fit:
        """The evidence where the steps ended."""
        terms, (columns, light, model, residual, variance, weight) = self._terms, self._look()
        normal, pull = self._system(columns, residual, weight)
        deviation, root = self.value - self._mean, np.linalg.cholesky(np.linalg.inv(self._prior))
        logdet = float(np.linalg.slogdet(root.T @ normal @ root + np.eye(len(root)))[1])
        density = float(np.sum(t_log_density(residual, variance, terms.full), dtype=np.float64))
        evidence = density / terms.area + self.gained
        evidence -= 0.5 * float(deviation @ self._prior @ deviation) + 0.5 * logdet
        body = (light**2 > terms.noise / terms.area) & ~terms.full
        chi2 = float(np.mean((residual**2 / variance)[body])) if body.any() else 0.0
        nothing, unlit = np.empty(0, np.float32), np.empty(0, np.intp)
        maps = nothing, residual, weight, model, light, (slice(0, len(residual)),) * 2, columns
        curvature, firm_pull = self._firm(normal + self._prior, pull)
        pull = np.where(firm_pull == pull, pull, 0.0)
        return Fit(nothing, evidence, chi2, nothing, *maps, self._precision, deviation, curvature, pull, unlit)
