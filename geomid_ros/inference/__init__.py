"""One Gaussian engine under the geometric prior: evidence, selection among hypotheses, and their probability."""
