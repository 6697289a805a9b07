"""Colours of pictures and pages; the colours of a page's text, light and dark, are in ``page.html.j2``.

Black is measured, grey is the URDF, and colour is identified: links by ``SHARES``, lines and dots by ``IDENTIFIED``.
For colour-blind readers: vermilion and blue by Okabe and Ito; lines also differ in their dashes.
"""

INK, FAINT = "#1a1a1a", "#6b7075"
MEASURED = INK
URDF, BEFORE, INERTIAS_ONLY, IDENTIFIED = "#9a9fa5", "#7d848a", "#0072b2", "#d55e00"
DOUBT = "#b3261e"
GRID, FLOOR, FRAME, STICKS = "#eceeef", "#e9edf0", "#c8cbce", "#3c4043"
SHARES = ("#dcdcd8", "#9ad3c4", "#41b0c4", "#1d70b2", "#1f2a80")
"""Scale of the fraction from data, from 0 to 1."""
