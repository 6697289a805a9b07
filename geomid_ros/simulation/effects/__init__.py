"""Physical effects beside the inertias.

One file per way in which effects enter, each with a table: ``structure`` adds bodies and hinges before the model is
compiled, ``model`` sets its constants, ``friction`` its dry friction at every state, ``forces`` are efforts at every
state, ``measurement`` changes what is recorded. ``sizes`` says how large each is by default. A new effect is one small
function and one line in one of those tables, and the same in ``sizes``.
"""
