"""Results drawn and written: figures, scenes, the page, exports, studies."""
