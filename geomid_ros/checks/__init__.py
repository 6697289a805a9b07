"""Whether a recording as a whole is that of this robot: signs, units, order of joints, gravity, wrench sensors."""
