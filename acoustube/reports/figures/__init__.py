"""Figures by matplotlib, returned as they are drawn: not shown and not saved."""
