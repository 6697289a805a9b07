"""Many bags of many robots: summaries of bags made side by side, summed by robot, and solved."""
