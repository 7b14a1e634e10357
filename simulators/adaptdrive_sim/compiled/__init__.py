"""The deployed source, compiled: whole experiments at some hundred times the speed.

`translate` makes compilable copies of the modules of controller and plant, `objects` lets the
compiler see their objects, `vectors` stands in for lists, and `run` runs an experiment.
"""
