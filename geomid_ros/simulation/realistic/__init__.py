"""A robot as robots are: friction that slips before it slides, motors with cogging and ripple, encoders with steps,
clocks that jitter and messages that are lost.

All of it is drawn from the seed; what is hidden comes on top. The rigid bodies are MuJoCo's, the rest is computed here,
and nothing is shared with the effects that the estimator knows.
"""
