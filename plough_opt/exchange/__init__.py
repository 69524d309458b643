"""Scenes and results for other tools: components, exports, saved results."""
