"""Presentation of results.

`figures` (plots), `scenes` (3-D), `page` (HTML), `export` (files of other programs), `studies` (of
the sleeve paper), `design` (a designed sensor) and `sleeve_table` (the layout of a sleeve).
"""
