"""Many presses: a plan of cases, the tasks that they share, and their resumable execution.

Read `plan` and `plan_text` (cases), `graph` (those that share a press or its scattering), `tasks`
and `case_results` (on workers), `runner`, `workers` and `run` (scheduling), `store` (files),
`costs` and `progress` (expected times), `select` (cases of figures and pages); then `cycles` and
`dataset` (cycles of a rangefinder).
"""
