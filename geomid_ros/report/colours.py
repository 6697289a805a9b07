"""The colours of pictures and pages; those of a page's own text, light and dark, are in ``page.html.j2``.

Black is the measured, grey the URDF and colour the identified: links by ``SHARES``, lines and dots by ``IDENTIFIED``.
For the colour-blind: Okabe and Ito's vermilion and blue; lines differ in their dashes, too.
"""

INK, FAINT = "#1a1a1a", "#6b7075"
MEASURED = INK
URDF, BEFORE, INERTIAS_ONLY, IDENTIFIED = "#9a9fa5", "#7d848a", "#0072b2", "#d55e00"
GRID, FLOOR, FRAME, STICKS = "#eceeef", "#e9edf0", "#c8cbce", "#3c4043"
SHARES = ("#dcdcd8", "#9ad3c4", "#41b0c4", "#1d70b2", "#1f2a80")
"""Of what is known from data: from nothing to all."""
