"""Figures of the HTML report: pure functions from arrays to SVG text, one figure a module.

Colours are class names (``q0`` .. for values, ``g0`` .. for groups) that the page's style sheet resolves, so a figure
follows the reader's light or dark theme.
"""
