"""Identify the link inertias of an arm from a recording, and look at the result.

Run it from anywhere: ``python examples/identify.py``. It writes into ``geomid_out``.
"""

from pathlib import Path

import geomid_ros

BAGS = Path(__file__).parents[1] / "bags"

# The recording has joint states and a wrench sensor at the wrist. The last 30 % of it are held out to judge on.
found = geomid_ros.identify(BAGS / "arm7", BAGS / "arm7.urdf", wrench="/wrench:wrist_ft:mounted")
print(found)

# How sure is it? Every number has a standard deviation, and says how much of it came from the data.
tool = found.links[-1]
print(f"\n{tool.name} weighs {tool.mass:.4f} ± {tool.std_mass:.4f} kg, its centre of mass is at {tool.com.round(3)} m")

# How well does it predict? RMS on data that were not used: of the URDF, and of the estimate.
for channel, rms in found.rms.items():
    print(f"{channel:>12}: {found.rms_nominal[channel]:8.3f} -> {rms:.3f}")

# Friction, rotor inertia and sensor offsets are identified along with the inertias.
for effect in found.effects:
    if effect.joint == "joint2":
        print(f"{effect.name} of {effect.joint}: {effect.value:.3f} ± {effect.std:.3f} {effect.unit}")

# estimate.json, identified.urdf (the input with other inertials) and a picture. ``found.plot()`` gives the figure.
print("\nWritten:", *found.save("geomid_out"))
