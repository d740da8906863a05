"""Baseband of cycles that are sampled below the Nyquist rate of their carrier.

At a sampling rate of 80 kHz the band about 42 kHz is folded about 40 kHz: each component of the
spectrum is the sum of those at two frequencies, one of them conjugate. With each sample multiplied
by -1 to the power of its number, such a record is the real part of the complex baseband about half
the sampling rate, which the forward model gives as well. It holds half the information of a record
at twice the rate.

References
----------
* Sampling of band-limited signals below the Nyquist rate: Vaughan, R. G., Scott, N. L. and White,
  D. R. (1991). IEEE Transactions on Signal Processing 39, 1973-1984.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import KHZ
from acoustube.inversion.band import is_compressed
from acoustube.inversion.baseband import TAPER, Baseband
from acoustube.inversion.wrap import Wrap
from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import HALF_WIDTH, oversampling, sent_spectrum
from acoustube.waves.scattering import Complex

HALF_BAND = 0.13
"""Half width of the band about half the sampling rate, relative to the carrier frequency."""
FARTHEST = 0.08
"""Largest allowed difference of carrier and half the sampling rate, relative to the carrier."""
RING_DOWN_OVERSAMPLING = 4
"""Ratio of the rate at which the ring-down of a folded band is computed to the sampling rate."""


class FoldedBaseband(Baseband):
    """Baseband of cycles sampled below the Nyquist rate of their carrier; its samples are real.

    As on EchoTube's board, the voltage is not filtered before it is sampled. The parameters are
    those of :class:`acoustube.inversion.Baseband`.

    Raises
    ------
    ConfigError
        If the carrier is not near half the sampling rate, or a cycle is too short.
    """

    freedom = 0.5

    def _period(self, least: int) -> int:
        """Return the period of the Fourier transforms in samples, even and at least `least`."""
        return 2 * int(next_fast_len(-(-least // 2)))

    def _band(self, carrier: float) -> tuple[NDArray[np.int_], Array]:
        """Return the bins of the frequencies about half the sampling rate, and their taper."""
        middle = self.rate / 2
        if abs(carrier - middle) > FARTHEST * carrier:
            raise ConfigError(
                f"a sampling rate of {self.rate:g} Hz aliases the band of a carrier of "
                f"{KHZ * carrier:g} kHz; record at {2.2 * (1 + HALF_WIDTH) * carrier:.0f} Hz or "
                f"more, or at about {2 * carrier:.0f} Hz"
            )
        half = int(HALF_BAND * carrier / self.step)
        offset = np.arange(-half, half)
        width = 2 * TAPER * half
        taper = np.sin(pi / 2 * np.clip((half - np.abs(offset)) / width, 0, 1)) ** 2
        return self.period // 2 + offset, taper

    def transformed(self, spectrum: Complex) -> Complex:
        """Return the real part of the baseband in counts, (..., n_time), as complex numbers.

        Parameters
        ----------
        spectrum : ndarray
            Spectra in counts s, (..., n_f), or at every m-th frequency (:meth:`.Baseband.every`).
        """
        samples = super().transformed(spectrum)
        samples = samples * self._signs.astype(samples.real.dtype)
        return np.asarray(samples.real, samples.dtype)

    def adjoint(self, samples: Complex) -> Complex:
        """Return the adjoint of :meth:`transformed` applied to samples (..., n), as (..., n_f).

        It is the adjoint for the real part of the inner product, since the samples are real.
        """
        return super().adjoint(samples * self._signs[: samples.shape[-1]])

    def ring_down(self) -> Complex:
        """Return the ring-down in the baseband in counts, from the rangefinder's parameters."""
        every = RING_DOWN_OVERSAMPLING
        r, n, rate = self.rangefinder, every * self.period, every * self.rate
        f = np.asarray(np.fft.rfftfreq(n, 1 / rate)[1:], float).astype(complex)
        spectrum = r.send * sent_spectrum(r, f, rate, n, 0.0) * r.resonator(f)
        spectrum *= np.exp(-2j * pi * f * r.lead) * self.per_volt
        samples = np.fft.irfft(np.concatenate([[0], spectrum]) * rate, n)[::every]
        return self._of_samples(samples[: self.n_samples])

    @property
    def _signs(self) -> Array:
        return np.asarray(1.0 - 2.0 * (self.used % 2))

    def _of_samples(self, samples: Array) -> Complex:
        # Each half of the band holds the whole record.
        return super()._of_samples(samples) / 2

    def _drive(self) -> Complex:
        r = self.rangefinder
        grid = np.arange(1, self.bins[-1] + 1) * self.step
        sent = sent_spectrum(r, grid.astype(complex), self.rate, self.period, 0.0)
        return np.asarray(sent[self.bins - 1])


@checked(rangefinder=Rangefinder)
def baseband_of(
    rangefinder: Rangefinder,
    radius: float,
    length: float,
    temperature: float,
    modes: tuple[str, ...],
    n_samples: int | None = None,
    wrap: Wrap | None = None,
) -> Baseband:
    """Return the baseband of a rangefinder, folded if its band exceeds half the sampling rate.

    The parameters and errors are those of :class:`acoustube.inversion.Baseband`, and for a folded
    band also those of :class:`FoldedBaseband`. The band of a chirp or of tones is not folded, but
    refused.
    """
    below = oversampling(rangefinder) == 1 or is_compressed(rangefinder)
    kind = Baseband if below else FoldedBaseband
    return kind(rangefinder, radius, length, temperature, modes, n_samples, wrap)
