"""The paper's studies as code: each gives its numbers beside the published ones.

A study is a function ``study(scale, work, report)`` that returns a
:class:`~acoustube.reports.studies.report.Study`. It uses sweeps, datasets, processing and
estimators as anyone would. ``acoustube reproduce`` runs them; see :mod:`acoustube.cli.reproduce`.
"""
