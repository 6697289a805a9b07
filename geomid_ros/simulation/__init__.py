"""Robots simulated in MuJoCo that record rosbags: planted truth for demonstrations and tests.

The bag holds only what a real robot would publish; the truth goes into a separate file. Nothing here shares code with
the estimator. MuJoCo is imported when a simulation starts.
"""
