"""Presentation of results: figures, scenes, the page, exports, studies."""
