"""A synthetic RGB-D sensor with exact ground truth, for the demo, the tests and the evaluation.

Seeds 0 to 99 are for development and tuning; report results on seeds of 1000 and above only.
"""
