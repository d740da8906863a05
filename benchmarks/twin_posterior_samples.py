"""Laplace's approximation of a twin's posterior, against samples of the posterior.

The posterior of a hidden sensor of `twin_hidden_sensors.py`, with unknown scatter of positions,
levels and correction, is sampled with the nonlinear model. Gibbs sampling: the scatters, given
the parameters, are independent and drawn on their grids; the parameters, given the scatters, by
the Metropolis-Hastings rule from proposals that leave the linearised posterior for those scatters
invariant (autoregressive, of random width), and by jumps to independent samples of Laplace's
posterior, including scatters, which only the model's curvature rejects. The chains start at the
maximum.

Usage: python benchmarks/twin_posterior_samples.py --sensor 3 --steps 4000
"""

from __future__ import annotations

import argparse
import time
from functools import cached_property
from itertools import product

import numpy as np
from twin_hidden_sensors import LENGTH, RATE, drawn, recorded

from acoustube.inversion.twin import fit_twin
from acoustube.inversion.twin.estimate import _quantised_levels
from acoustube.inversion.twin.fit import Point, normal_equations
from acoustube.inversion.twin.model import CORRECTIONS, LOCAL, SHARED
from acoustube.inversion.twin.posterior import (
    COLOURS,
    LEVELS,
    PLACEMENTS,
    USUAL,
    _given,
    posterior,
    with_scatter,
)

SHOWN = (
    "log_radius", "temperature_offset", "temperature_gradient", "log_resonance", "log_quality",
    "log_gain", "drive_cycles", "trigger", "face_real",
)  # fmt: skip
WIDTHS = 0.15, 0.4, 1.0
BURN_IN = 0.2


class Target:
    """Posterior of shared and local parameters, and its linearisation at the maximum."""

    def __init__(self, twin, extra):
        self.twin, self.extra = twin, extra
        self.normal = normal_equations(twin.model, twin.data, twin.point)
        self.p, self.n = len(SHARED), len(twin.model.places)
        size, k = self.p + len(LOCAL) * self.n, len(LOCAL)
        self.hessian, self.right = np.zeros((size, size)), np.zeros(size)
        self.hessian[: self.p, : self.p] = self.normal.shared
        self.right[: self.p] = self.normal.right_shared
        for i in range(self.n):
            own = slice(self.p + k * i, self.p + k * (i + 1))
            self.hessian[own, own] = self.normal.local[i]
            self.hessian[: self.p, own] = self.normal.mixed[i]
            self.hessian[own, : self.p] = self.normal.mixed[i].T
            self.right[own] = self.normal.right_local[i]
        self.centre = self.joined(twin.point)

    def joined(self, point):
        """Return the parameters as a vector."""
        return np.concatenate([point.shared, point.local.ravel()])

    def point(self, x):
        """Return a vector as parameters."""
        return Point(x[: self.p], x[self.p :].reshape(self.n, len(LOCAL)))

    def prior(self, scatter):
        """Return mean and deviation of the normal prior, given the scatters."""
        deviation = self.twin.prior.deviation.copy()
        deviation[list(CORRECTIONS)] = scatter[2]
        local = self.twin.prior.local.copy()
        local[:, 0], local[:, 1] = scatter[0], np.hypot(scatter[1], self.extra)
        mean = np.concatenate([self.twin.prior.mean, np.zeros(local.size)])
        return mean, np.concatenate([deviation, local.ravel()])

    def linearised(self, scatter):
        """Return mean and Cholesky factor of the precision of the linearised posterior."""
        mean, deviation = self.prior(scatter)
        precision = self.hessian + np.diag(deviation**-2.0)
        step = self.right - deviation**-2.0 * (self.centre - mean)
        # Parameters differ by orders of magnitude.
        scale = 1 / np.sqrt(np.diag(precision))
        factor = np.linalg.cholesky(precision * scale[:, None] * scale)
        move = scale * np.linalg.solve(factor.T, np.linalg.solve(factor, scale * step))
        return self.centre + move, factor, scale

    def misfit(self, x):
        """Return the sum of the weighted squares of the residuals."""
        left = self.twin.data.values - self.twin.model(*self.point(x)).value
        return float(np.sum(self.twin.data.weights * np.abs(left) ** 2))

    @cached_property
    def cases(self):
        """Scatters of the grid, and their shares in Laplace's posterior."""
        cases, score = list(product(PLACEMENTS, LEVELS, COLOURS)), []
        for case in cases:
            spread = np.hypot(case[1], self.extra)
            own = with_scatter(self.twin.prior, case[0], spread, case[2])
            value = _given(self.normal, own, self.twin.point)[0]
            for one, (median, width) in zip(case, USUAL, strict=True):
                value -= 0.5 * (np.log(one / median) / width) ** 2
            score.append(value)
        share = np.exp(np.array(score) - max(score))
        return cases, share / share.sum()

    def straight(self, x):
        """Return the misfit of the linearised model."""
        off = x - self.centre
        return self.normal.misfit - 2 * self.right @ off + off @ self.hessian @ off

    def scatters(self, x, random):
        """Return scatters drawn given the parameters."""
        point, found = self.point(x), []
        parts = (
            (PLACEMENTS, point.local[:, 0], np.zeros(self.n)),
            (LEVELS, point.local[:, 1], self.extra),
            (COLOURS, (point.shared - self.twin.prior.mean)[list(CORRECTIONS)], 0.0),
        )
        for (grid, values, extra), (median, width) in zip(parts, USUAL, strict=True):
            variance = grid[:, None] ** 2 + np.broadcast_to(extra, values.shape) ** 2
            score = -0.5 * np.sum(values**2 / variance + np.log(variance), axis=1)
            score -= 0.5 * (np.log(grid / median) / width) ** 2
            share = np.exp(score - score.max())
            found.append(float(random.choice(grid, p=share / share.sum())))
        return found


def chain(target, steps, random):
    """Return samples of the shared parameters, and the accepted share."""
    x, misfit, scatter = target.centre.copy(), target.misfit(target.centre), [1e-3, 0.02, 0.01]
    cases, share = target.cases
    samples, accepted, jumped = np.zeros((steps, target.p)), 0, 0
    for i in range(steps):
        scatter = target.scatters(x, random)
        mean, factor, scale = target.linearised(scatter)
        prior_mean, deviation = target.prior(scatter)

        def excess(at, misfit, mean=mean, factor=factor, scale=scale, m=prior_mean, s=deviation):
            # Minus twice the log density, less that of the linearised posterior.
            own = misfit + np.sum(((at - m) / s) ** 2)
            return own - np.sum((factor.T @ ((at - mean) / scale)) ** 2)

        width = random.choice(WIDTHS)
        noise = scale * np.linalg.solve(factor.T, random.normal(size=len(x)))
        trial = mean + np.sqrt(1 - width**2) * (x - mean) + width * noise
        found = target.misfit(trial)
        if np.log(random.random()) < 0.5 * (excess(x, misfit) - excess(trial, found)):
            x, misfit, accepted = trial, found, accepted + 1
        # A jump to another sample of Laplace's posterior: only the curvature rejects it.
        mean, factor, scale = target.linearised(cases[random.choice(len(cases), p=share)])
        trial = mean + scale * np.linalg.solve(factor.T, random.normal(size=len(x)))
        found = target.misfit(trial)
        curved = misfit - target.straight(x), found - target.straight(trial)
        if np.log(random.random()) < 0.5 * (curved[0] - curved[1]):
            x, misfit = trial, found
            jumped += 1
        samples[i] = x[: target.p]
    return samples[int(BURN_IN * steps) :], (accepted / steps, jumped / steps)


def effective(chains):
    """Return the effective number of samples of (n_chains, n), from the autocorrelation."""
    n, total = chains.shape[1], 0.0
    centred = chains - chains.mean()
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    rho = np.fft.irfft(spectrum.mean(axis=0))[:n] / np.arange(n, 0, -1)
    rho /= rho[0]
    for a, b in zip(rho[1::2], rho[2::2], strict=False):
        if a + b < 0:
            break
        total += a + b
    return chains.size / (1 + 2 * total)


def main() -> None:
    """Print means and deviations of both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sensor", type=int, default=3)
    parser.add_argument("--steps", type=int, default=4000)
    parser.add_argument("--chains", type=int, default=4)
    given = parser.parse_args()
    random = np.random.default_rng([given.sensor, 22])
    closed, free = recorded(drawn(random), random)
    twin = fit_twin(closed, free, RATE, length=LENGTH)
    extra = _quantised_levels(closed, twin.data, np.array(twin.used))
    target, started = Target(twin, extra), time.process_time()
    laplace = posterior(target.normal, twin.prior, twin.point, extra)
    found = [
        chain(target, given.steps, np.random.default_rng([given.sensor, k]))
        for k in range(given.chains)
    ]
    samples = np.array([one for one, _ in found])
    print(
        f"sensor {given.sensor}: {samples.shape[0]} chains of {given.steps} steps, accepted "
        f"{[f'{share[0]:.2f}, {share[1]:.2f}' for _, share in found]}, "
        f"{time.process_time() - started:.0f} s"
    )
    for name in SHOWN:
        i = SHARED.index(name)
        own, sd = samples[:, :, i], float(np.sqrt(laplace.covariance[i, i]))
        between = own.mean(axis=1).var(ddof=1) / own.var(axis=1).mean()
        low, high = (np.quantile(own, [0.05, 0.95]) - laplace.mean[i]) / sd
        print(
            f"{name:21} mean off by {(own.mean() - laplace.mean[i]) / sd:+.2f} deviations, "
            f"deviation {own.std() / sd:.2f} times Laplace's, 90 % from {low:+.2f} to {high:+.2f}; "
            f"{effective(own):.0f} effective samples, R-hat {np.sqrt(1 + between):.3f}"
        )


if __name__ == "__main__":
    main()
