"""Results as one HTML file that opens from disk, without a network.

Reading order: `content` (states of a pressed tube), `runs` and `cases` (from files), `shapes` and
`solid` (surfaces), `encoded` (JSON) and `write`.
"""

from acoustube.reports.page.write import read

__all__ = ["read"]
