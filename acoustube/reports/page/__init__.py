"""Results as one HTML file that opens from disk, without a network."""

from acoustube.reports.page.write import read, write_page

__all__ = ["read", "write_page"]
