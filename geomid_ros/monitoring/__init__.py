"""Whether a stream is what it claims to be: change detection, plausibility of wrenches."""
