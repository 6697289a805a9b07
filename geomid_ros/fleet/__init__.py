"""Many bags of many robots: bags are summarised in parallel, summaries are summed by robot, and robots are solved."""
