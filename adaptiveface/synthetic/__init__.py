"""Simulate an RGB-D sensor whose ground truth is known exactly, for the demo, the tests and the evaluation.

Seeds 0 to 99 are for development and tuning; report results on seeds of 1000 and above only.
"""
