"""Waveform inversion: number, places, depths and forces of presses from the whole echo.

Reading order: `tools` (scattering of tools over depth), `tables` and `spline_sums` (interpolation
of that scattering), `paths` and `wrap` (propagation along straight and wrapped tubes), `network`,
`network_sums`, `joints`, `joint_sums`, `coupled_network` and `small_matrices` (echo of presses
along a tube), `quantiser` (rounded samples), `band`, `baseband` and `folded` (cycles of the
rangefinder), `clutter`, `recorded_sums` (spectra of echo and clutter), `model` (forward model and
its priors), `parameters` (places, depths and nuisance parameters, prior odds of a press),
`whitening` and `likelihood` (covariance and deviance), `fit` (maxima of the likelihood), `search`
and `sample_sums` (candidates), `other_maxima` (at other depths and half wavelengths away),
`hypotheses` (sets of presses), `peeling` (presses in the order of time), `doubt` (whether one more
press is real), `model_error` (effect of the model's error), `posterior` and `mixture_quantiles`
(distributions of the estimates), `detection` (limit of detection), `goodness` (goodness of fit) and
`estimate` (inversion of a recording); `two_ends` (a rangefinder at each end). For contacts that
move, cycle by cycle: `motion` (the filter), `proposals` and `births` (new contacts), `fewer` (fits
with fewer contacts), `cycle` and `tracks` (one hypothesis, updated by each cycle) and `tracking`.
Packages: `twin` (parameters of a rangefinder from recordings) and `design` (expected accuracy of a
sensor).
"""

from acoustube.inversion.baseband import Baseband
from acoustube.inversion.clutter import Clutter, measured_clutter, unknown_clutter
from acoustube.inversion.estimate import Contact, Inversion, Inverter
from acoustube.inversion.folded import baseband_of
from acoustube.inversion.model import ForwardModel, Priors
from acoustube.inversion.motion import Motion
from acoustube.inversion.posterior import Estimate
from acoustube.inversion.tools import Library, Tool
from acoustube.inversion.tracking import ContactTracker, Tracked
from acoustube.inversion.two_ends import joined_contacts
from acoustube.inversion.wrap import Wrap

__all__ = [
    "Baseband", "Clutter", "Contact", "ContactTracker", "Estimate", "ForwardModel", "Inversion",
    "Inverter", "Library", "Motion", "Priors", "Tool", "Tracked", "Wrap", "baseband_of",
    "joined_contacts", "measured_clutter", "unknown_clutter",
]  # fmt: skip
