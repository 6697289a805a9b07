"""Find out why a simulation of an arm disagrees with a recording: which joint, which effect, how large.

Run it from anywhere: ``python examples/gap.py``. It writes into ``geomid_gap``.
"""

from pathlib import Path

import geomid_ros

BAGS = Path(__file__).parents[1] / "bags"

# The URDF knows nothing of friction, rotor inertia or sensor offsets, and the arm has them at every joint. The last
# 30 % of the recording are held out to judge on.
gap = geomid_ros.find_gap(BAGS / "arm7", BAGS / "arm7.urdf")
print("Verdict:", gap.verdict)

# What was found, the surest first, with its parameters and how sure the name is.
for finding in gap.findings:
    parameters = ", ".join(f"{name} {q.value:.3g} ± {q.std:.1g} {q.unit}" for name, q in finding.parameters.items())
    print(f"{finding.effect} {finding.joint}: {parameters} ({finding.confidence})")

# What the model leaves on held-out data, in units of the noise floor: 1 is as good as any model can be.
print("\nchannel, before and after:")
for channel, before, after in zip(gap.result.channels, gap.result.gap.before, gap.result.gap.after, strict=True):
    print(f"{channel:>12}: {before:6.2f} -> {after:.2f}")

# report.html with all pictures, gap.json, and the model with what was found: URDF, MJCF, estimate.json. Only the page:
# ``gap.report("report.html")``.
print("\nWritten:", *gap.save("geomid_gap"))
