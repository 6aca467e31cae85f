"""Evaluation: `metrics` of a disparity map, `evaluate` a method on a data set, `report` the results."""
