"""The blind bench on robots as robots are: one change hidden under friction, cogging, drift and coarse sensors.

Every seed is one robot, recorded without the change and, in another motion, with it. Two questions are asked of
``geomid gap``: what is wrong in the second recording by the model identified from the first, and by the URDF alone.
Nothing here imports the package but ``geomid_ros.simulation``, its errors and types.

The change is as large as it has to be for the worst channel to lie at 3 to 10 times the floor beside link inertias that
both recordings fit best. The floor is what nobody can model: noise, rounding, cogging and ripple, below 5 Hz. In the
second recording alone inertias may take the whole change, as of a payload: the second question counts where they
leave 3 times the floor.

A name is wrong where the robot has nothing of the kind: dry and viscous friction, rotor inertia, offsets, gains and
links that differ from the URDF are true of every joint. A delay is wrong where it is more than 2 ms off. Sizes of
friction, rotors and springs count in measured efforts, gains included, since nothing tells a gain from them.
"""
