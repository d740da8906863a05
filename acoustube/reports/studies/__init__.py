"""Studies of the sleeve paper as code: each compares simulated with published numbers.

The sleeve paper is "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing".

A study is a function ``study(scale, work, report)`` that returns a
:class:`~acoustube.reports.studies.report.Study`. It uses the public functions for sweeps, datasets,
processing and estimators. ``acoustube reproduce`` runs studies; see :mod:`acoustube.cli.reproduce`.

Reading order: `report` (what a study returns), `presses`, `ranged` and `inverted` (common parts);
`calibration`, `simulation` (`simulation_cases`, `simulation_figures`), `flat` (`flat_figures`,
`whole_echo`), `mannequin` and `human` (`arm`, `human_figures`), `swipe` and `echotube`.
"""
