"""Physical effects beside the inertias.

One file per way in which effects enter, each with a table: ``structure`` adds bodies and hinges before the model is
compiled, ``model`` sets its constants, ``forces`` are dry friction and other efforts at every state, ``measurement``
changes what is recorded. ``sizes`` says how large each is by default. A new effect is one small function, named after
it, in one of those tables, and a public function in ``sizes``.
"""
