"""The blind bench: effects hidden by the generator, found by ``geomid gap`` as a process, compared with the truth.

Generator and workflow share no code: nothing here imports the package but ``geomid_ros.simulation``, its errors and
types, and the two meet in rosbags only.

What counts: a single effect counts for being found where the workflow's own gap beside fitted inertias reaches 1.15
times the floor in some channel; how many do not is a line of the table. Right means that effect and joint agree (a
payload's joint is the one that moves its link). Some effects are others' aliases, whatever the motion: a payload is an
error of the link itself, and so is the rotor of a first joint about its own axis, so only their size beside the usual
error of inertias tells them; offset, tilt and a spring share what does not vary over the range. Such cases stay in the
draw and in the counts. A gear that gives has a light rotor, and uneven friction a mean: those names are no mistakes.
"""
