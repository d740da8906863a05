"""Figures and page of a design."""
